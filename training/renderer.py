# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenGL drawing of a world: colour and exact z-depth.

Row 0 of every array is the top of the picture: the projection turns y over, so nothing has to be flipped afterwards.
A pixel (column i, row j) is sampled at (i + 0.5, j + 0.5), as in COLMAP.
"""

from collections import OrderedDict
from dataclasses import dataclass

import moderngl
import numpy as np

from training.assets import Assets, Material, Mesh
from training.scene import World
from training.shaders import FRAGMENTS, SKY_FRAGMENT, SKY_VERTEX, VERTEX

SHADOW_SIZE = 1024
NEAR = 0.25  # metres
EVERYTHING = -1e6  # metres: what is lower than this is not drawn
TEXTURE_BUDGET = 400  # textures kept on the GPU
MESH_BUDGET = 400
_CLIP_DISTANCE = 0x3000  # OpenGL's switch for what gl_ClipDistance[0] cuts off
_ATTRIBUTE_SIZES = {"in_position": 3, "in_normal": 3, "in_uv": 2, "in_uv2": 2}


@dataclass(frozen=True)
class _Draw:
    """One draw call of the current world; centre (3,) and radius bound it in the world."""

    mesh: "_GpuMesh"
    material: Material
    transform: np.ndarray
    normal_matrix: np.ndarray
    tint: tuple[float, float, float]
    gloss: float
    contrast: float
    centre: np.ndarray
    radius: float


class _GpuMesh:
    """Vertex and index buffers of a mesh, with a vertex array for every program that draws it."""

    def __init__(self, context: moderngl.Context, mesh: Mesh) -> None:
        vertices = np.concatenate([mesh.positions, mesh.normals, mesh.uv, mesh.uv2], axis=1).astype("f4")
        self._context = context
        self._vertices = context.buffer(vertices.tobytes())
        self._indices = context.buffer(np.ascontiguousarray(mesh.faces, "i4").tobytes())
        self._arrays: dict[moderngl.Program, moderngl.VertexArray] = {}
        low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
        self.centre = (low + high) / 2
        self.radius = float(np.linalg.norm(high - low) / 2)

    def draw(self, program: moderngl.Program) -> None:
        if program not in self._arrays:
            # A program without lighting drops attributes; their bytes are skipped.
            layout = " ".join(f"{n}f" if name in program else f"{4 * n}x" for name, n in _ATTRIBUTE_SIZES.items())
            used = [name for name in _ATTRIBUTE_SIZES if name in program]
            content = [(self._vertices, layout, *used)]
            self._arrays[program] = self._context.vertex_array(program, content, index_buffer=self._indices)
        self._arrays[program].render()

    def release(self) -> None:
        for array in self._arrays.values():
            array.release()
        self._vertices.release()
        self._indices.release()


def _set(program: moderngl.Program, **values: object) -> None:
    """Set uniforms by name; ones that the compiler dropped are passed over, matrices (row-major) are transposed."""
    for name, value in values.items():
        uniform = program.get(name, None)
        if not isinstance(uniform, moderngl.Uniform):
            continue
        if isinstance(value, np.ndarray):
            matrix = value.T if value.ndim == 2 and value.shape[0] == value.shape[1] else value
            uniform.write(np.ascontiguousarray(matrix, "f4").tobytes())
        else:
            uniform.value = value


class Renderer:
    """Draws worlds; models and textures stay on the GPU between worlds."""

    def __init__(self, assets: Assets, samples: int | None = None) -> None:
        """`samples` a pixel for colour (depth always has one); None: 4 on a GPU, 1 on software OpenGL, where 4 cost
        as much as two more pictures."""
        self.assets = assets
        self.context = moderngl.create_context(standalone=True, backend="egl")  # type: ignore[arg-type]
        self.context.enable_direct(_CLIP_DISTANCE)
        software = "llvmpipe" in self.context.info["GL_RENDERER"]
        self._samples = samples or (1 if software else min(4, self.context.max_samples))
        self._programs: dict[tuple[str, int, bool, bool, bool, int], moderngl.Program] = {}
        self._sky = self.context.program(vertex_shader=SKY_VERTEX, fragment_shader=SKY_FRAGMENT)
        self._sky_array = self.context.vertex_array(self._sky, [])
        self._textures: OrderedDict[str, tuple[moderngl.Texture, float]] = OrderedDict()
        self._meshes: OrderedDict[str, list[_GpuMesh]] = OrderedDict()
        self._temporary: list[_GpuMesh] = []
        self._targets: dict[tuple[int, int], moderngl.Framebuffer] = {}
        self._smooth_targets: dict[tuple[int, int], tuple[moderngl.Framebuffer, moderngl.Framebuffer]] = {}
        self._mirrors: dict[tuple[int, int], tuple[moderngl.Framebuffer, moderngl.Texture]] = {}
        self._shadow_map = self.context.depth_texture((SHADOW_SIZE, SHADOW_SIZE))
        self._shadow_map.compare_func = "<="
        self._shadow_map.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self._shadow_map.repeat_x = self._shadow_map.repeat_y = False
        self._shadow_target = self.context.framebuffer(depth_attachment=self._shadow_map)
        self._draws: list[_Draw] = []
        self._world: World | None = None
        self._far = 100.0

    def upload(self, world: World) -> None:
        """Make `world` the one that is drawn, and draw its shadow map."""
        for old in self._temporary:
            old.release()
        self._temporary = []
        self._draws = []
        while len(self._textures) > TEXTURE_BUDGET:
            self._textures.popitem(last=False)[1][0].release()
        for instance in world.instances:
            if instance.key is None:
                loaded = [_GpuMesh(self.context, m) for m in instance.meshes]
                self._temporary += loaded
            else:
                if instance.key not in self._meshes:
                    self._meshes[instance.key] = [_GpuMesh(self.context, m) for m in instance.meshes]
                self._meshes.move_to_end(instance.key)
                loaded = self._meshes[instance.key]
            transform = instance.transform
            normal_matrix = np.linalg.inv(transform[:3, :3]).T
            stretch = float(np.linalg.norm(transform[:3, :3], axis=0).max())
            for gpu_mesh, mesh in zip(loaded, instance.meshes, strict=True):
                cut = mesh.material.alpha_cut
                material = mesh.material if cut or instance.override is None else instance.override
                centre = transform[:3, :3] @ gpu_mesh.centre + transform[:3, 3]
                self._draws.append(
                    _Draw(
                        gpu_mesh,
                        material,
                        transform,
                        normal_matrix,
                        instance.tint,
                        instance.gloss,
                        instance.contrast,
                        centre,
                        gpu_mesh.radius * stretch,
                    )
                )
        used = {i.key for i in world.instances}
        while len(self._meshes) > MESH_BUDGET and next(iter(self._meshes)) not in used:
            for old in self._meshes.popitem(last=False)[1]:
                old.release()
        self._world = world
        self._far = 2.0 * max(world.terrain.far, 4 * world.terrain.radius)
        self._draw_shadow_map()

    def render(self, K: np.ndarray, cam_from_world: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Colour (H,W,4) uint8 and z-depth (H,W) float32 metres (0: sky) of one camera; size is (W, H). The fourth
        channel is 0 where the picture mirrors something: what is seen there does not lie at that depth."""
        if self._drawn.water is not None:
            self._draw_mirror(self._drawn.water.level, K, cam_from_world, size)
        target = self._target(size)
        if self._samples == 1:
            view_projection = self._draw_world("colour", target, K, cam_from_world, size)
            self._draw_sky(view_projection)
            return self._read_colour(target, size), self._read_depth(target, size)
        smooth, resolved = self._smooth_targets_of(size)
        view_projection = self._draw_world("colour", smooth, K, cam_from_world, size)
        self._draw_sky(view_projection)
        self.context.copy_framebuffer(resolved, smooth)
        return self._read_colour(resolved, size), self.render_depth(K, cam_from_world, size)

    def _draw_mirror(self, water: float, K: np.ndarray, cam_from_world: np.ndarray, size: tuple[int, int]) -> None:
        """What the water shows to a camera: the world above it, upside down."""
        upside_down = np.diag([1.0, 1.0, -1.0, 1.0])
        upside_down[2, 3] = 2 * water
        pose = cam_from_world @ upside_down
        view_projection = self._draw_world("colour", self._mirror(size)[0], K, pose, size, water)
        self._draw_sky(view_projection)

    def render_depth(self, K: np.ndarray, cam_from_world: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Only the z-depth (H,W) float32: a quick look before the full pictures."""
        target = self._target(size)
        self._draw_world("depth", target, K, cam_from_world, size)
        return self._read_depth(target, size)

    def _read_colour(self, target: moderngl.Framebuffer, size: tuple[int, int]) -> np.ndarray:
        return np.frombuffer(target.read(components=4), np.uint8).reshape(size[1], size[0], 4)

    def _read_depth(self, target: moderngl.Framebuffer, size: tuple[int, int]) -> np.ndarray:
        data = target.read(components=1, attachment=1, dtype="f4")
        return np.frombuffer(data, np.float32).reshape(size[1], size[0])

    def _target(self, size: tuple[int, int]) -> moderngl.Framebuffer:
        if size not in self._targets:
            self._targets[size] = self.context.framebuffer(
                color_attachments=[self.context.texture(size, 4), self.context.texture(size, 1, dtype="f4")],
                depth_attachment=self.context.depth_renderbuffer(size),
            )
        return self._targets[size]

    def _mirror(self, size: tuple[int, int]) -> tuple[moderngl.Framebuffer, moderngl.Texture]:
        if size not in self._mirrors:
            texture = self.context.texture(size, 4)
            texture.repeat_x = texture.repeat_y = False
            depth = self.context.depth_renderbuffer(size)
            self._mirrors[size] = self.context.framebuffer([texture], depth), texture
        return self._mirrors[size]

    def _smooth_targets_of(self, size: tuple[int, int]) -> tuple[moderngl.Framebuffer, moderngl.Framebuffer]:
        """Colour only: a target with several samples a pixel, and one to gather them in."""
        if size not in self._smooth_targets:
            smooth = self.context.framebuffer(
                color_attachments=[self.context.renderbuffer(size, 4, samples=self._samples)],
                depth_attachment=self.context.depth_renderbuffer(size, samples=self._samples),
            )
            resolved = self.context.framebuffer(color_attachments=[self.context.renderbuffer(size, 4)])
            self._smooth_targets[size] = (smooth, resolved)
        return self._smooth_targets[size]

    def _program(self, kind: str, material: Material) -> moderngl.Program:
        """The shader for a material; what only matters to colour is left out of the depth shader's key."""
        colour = kind == "colour"
        mode = (1 if material.blend is not None else 2 if material.box_mapped else 0) if colour else 0
        detail = colour and self._drawn.detail.strength > 0
        mirror = ("", "water", "glass").index(material.mirror) if colour else 0
        key = (kind, mode, material.alpha_cut, detail, colour and material.ao is not None, mirror)
        if key not in self._programs:
            flags = zip(("MODE", "CUT", "DETAIL", "AO", "MIRROR"), key[1:], strict=True)
            head = "#version 330\n" + "".join(f"#define {name} {int(value)}\n" for name, value in flags)
            self._programs[key] = self.context.program(head + VERTEX, fragment_shader=head + FRAGMENTS[kind])
        return self._programs[key]

    @property
    def _drawn(self) -> World:
        assert self._world is not None, "upload a world first"
        return self._world

    def _draw_world(
        self,
        kind: str,
        target: moderngl.Framebuffer,
        K: np.ndarray,
        cam_from_world: np.ndarray,
        size: tuple[int, int],
        lowest: float = EVERYTHING,
    ) -> np.ndarray:
        """Clear the target and draw what the camera may see, down to `lowest`; returns (4,4) clip-from-world."""
        world = self._drawn
        target.use()
        target.clear(0, 0, 0, 0)
        self.context.enable_only(moderngl.DEPTH_TEST)
        self.context.depth_func = "<="
        width, height = size
        projection = np.zeros((4, 4))
        projection[0, :3] = 2 * K[0] / width  # clip x = 2 u / W - 1, u measured from the left edge
        projection[1, :3] = 2 * K[1] / height  # the same for v, measured from the top: row 0 comes out as the top
        projection[:2, 2] -= 1
        far = self._far
        projection[2, 2:] = (far + NEAR) / (far - NEAR), -2 * far * NEAR / (far - NEAR)
        projection[3, 2] = 1
        view = np.vstack([cam_from_world, [0, 0, 0, 1]])
        view_projection = projection @ view
        eye = -cam_from_world[:, :3].T @ cam_from_world[:, 3]
        planes = view_projection[3] + np.concatenate([view_projection[:2], -view_projection[:2]])
        planes = planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
        seen = [d for d in self._draws if (planes[:, :3] @ d.centre + planes[:, 3]).min() > -d.radius]
        mirroring = lowest != EVERYTHING
        if mirroring:
            seen = [d for d in seen if d.material.mirror != "water"]
        seen.sort(key=lambda d: np.linalg.norm(d.centre - eye) + 0.3 * d.radius)  # near first: less is drawn twice
        light, detail = world.light, world.detail
        shared = {
            "u_view_projection": view_projection, "u_depth_row": view[2], "u_shadow": self._shadow_matrix(),
            "u_sun": light.sun, "u_sun_colour": light.sun_colour, "u_ambient": light.ambient.astype("f4"),
            "u_eye": eye, "u_haze": light.haze, "u_exposure": light.exposure, "u_haze_colour": (0.75, 0.8, 0.88),
            "u_texture": 0, "u_texture1": 1, "u_texture2": 2, "u_ao": 3, "u_detail": 4, "u_shadow_map": 5,
            "u_detail_tile": detail.tile, "u_detail_strength": detail.strength,
            "u_sky": 6, "u_sky_turn": light.sky_turn, "u_mirror": 7,
            "u_waves": world.water.waves if world.water else (1.0, 0.0, 0.0), "u_lowest": lowest,
        }  # fmt: skip
        if kind == "colour":
            texture, shared["u_detail_mean"] = self._texture(detail.texture)
            texture.use(4)
            self._shadow_map.use(5)
            self._texture(light.sky)[0].use(6)
            if world.water is not None and not mirroring:
                self._mirror(size)[1].use(7)
        self._draw_all(kind, seen, shared)
        return view_projection

    def _draw_all(self, kind: str, draws: list[_Draw], shared: dict[str, object]) -> None:
        ready = set()
        for draw in draws:
            material = draw.material
            program = self._program(kind, material)
            if program not in ready:
                ready.add(program)
                _set(program, **shared)
            if kind == "colour" or material.alpha_cut:
                self._texture(material.texture)[0].use(0)
            if kind == "colour" and material.blend is not None:
                self._texture(material.blend[0])[0].use(1)
                self._texture(material.blend[1])[0].use(2)
            if kind == "colour" and material.ao is not None:
                self._texture(material.ao)[0].use(3)
            _set(program, u_model=draw.transform, u_normal=draw.normal_matrix)
            _set(program, u_tiles=material.tiles, u_tint=draw.tint, u_gloss=draw.gloss,
                 u_contrast=draw.contrast, u_sheltered=material.sheltered)
            draw.mesh.draw(program)

    def _draw_sky(self, view_projection: np.ndarray) -> None:
        light = self._drawn.light
        # A clip point at infinity is the direction alone, so the translation column drops out.
        world_from_ndc = np.linalg.inv(view_projection[[0, 1, 3], :3])
        self._texture(light.sky)[0].use(0)
        _set(self._sky, u_texture=0, u_world_from_ndc=world_from_ndc, u_turn=light.sky_turn)
        self._sky_array.render(moderngl.TRIANGLES, vertices=3)

    def _shadow_matrix(self) -> np.ndarray:
        """(4,4) orthographic clip-from-world of the sun over the site."""
        world = self._drawn
        radius = 1.25 * max(world.site.radius, world.site.height) + 6
        sun = world.light.sun
        side = np.cross([0, 0, 1.0], sun)
        side /= np.linalg.norm(side)
        axes = np.stack([side, np.cross(sun, side), -sun]) / radius
        axes[2] *= 0.5  # twice the depth, for long shadows at low sun
        matrix = np.eye(4)
        matrix[:3, :3] = axes
        matrix[:3, 3] = -axes @ world.site.centre
        return matrix

    def _draw_shadow_map(self) -> None:
        self._shadow_target.use()
        self._shadow_target.clear(depth=1.0)
        self.context.enable_only(moderngl.DEPTH_TEST)
        self.context.depth_func = "<="
        self.context.polygon_offset = (1.5, 4.0)
        matrix = self._shadow_matrix()
        self._draw_all("depth", self._draws, {"u_view_projection": matrix, "u_depth_row": matrix[2], "u_texture": 0,
                                               "u_lowest": EVERYTHING})
        self.context.polygon_offset = (0.0, 0.0)

    def _texture(self, name: str) -> tuple[moderngl.Texture, float]:
        """The GPU texture and its mean level in [0, 1]."""
        if name not in self._textures:
            image = self.assets.texture(name)
            texture = self.context.texture(
                (image.shape[1], image.shape[0]), image.shape[2], np.ascontiguousarray(image).tobytes(), alignment=1
            )
            texture.build_mipmaps()
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            texture.anisotropy = 1.0  # more makes the software renderer crawl
            self._textures[name] = (texture, float(image[..., :3].mean()) / 255)
        self._textures.move_to_end(name)
        return self._textures[name]
