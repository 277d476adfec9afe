# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The programs that the renderer runs on the graphics card, in GLSL."""

# Every shader is compiled in variants (#define) because the software renderer runs both sides of a branch.
VERTEX = """
uniform mat4 u_model; uniform mat3 u_normal; uniform mat4 u_view_projection; uniform vec4 u_depth_row;
uniform mat4 u_shadow; uniform float u_lowest;
in vec3 in_position; in vec3 in_normal; in vec2 in_uv; in vec2 in_uv2;
out vec3 v_world; out vec3 v_normal; out vec2 v_uv; out vec2 v_uv2; out float v_depth; out vec3 v_shadow;
void main() {
    vec4 world = u_model * vec4(in_position, 1.0);
    v_world = world.xyz;
    v_normal = u_normal * in_normal;
    v_uv = in_uv; v_uv2 = in_uv2;
    v_depth = dot(u_depth_row, world);
    v_shadow = (u_shadow * world).xyz * 0.5 + 0.5;
    gl_Position = u_view_projection * world;
    gl_ClipDistance[0] = world.z - u_lowest;
}
"""

_SKY_UV = """
vec2 sky_uv(vec3 d, float turn) {    // where a direction is on a panorama
    return vec2((atan(d.y, d.x) + turn) / 6.2831853, acos(clamp(d.z, -1.0, 1.0)) / 3.1415927);
}
"""

_COLOUR_FRAGMENT = _SKY_UV + """
uniform sampler2D u_texture; uniform sampler2D u_texture1; uniform sampler2D u_texture2;
uniform sampler2D u_ao; uniform sampler2D u_detail; uniform sampler2DShadow u_shadow_map;
uniform vec3 u_tiles; uniform vec3 u_tint; uniform float u_gloss; uniform float u_contrast; uniform float u_sheltered;
uniform float u_detail_tile; uniform float u_detail_strength; uniform float u_detail_mean;
uniform vec3 u_sun; uniform vec3 u_sun_colour; uniform vec3 u_ambient[9];
uniform vec3 u_eye; uniform float u_haze; uniform float u_exposure; uniform vec3 u_haze_colour;
uniform sampler2D u_mirror; uniform sampler2D u_sky; uniform float u_sky_turn; uniform vec3 u_waves;
in vec3 v_world; in vec3 v_normal; in vec2 v_uv; in vec2 v_uv2; in float v_depth; in vec3 v_shadow;
layout(location = 0) out vec4 o_colour; layout(location = 1) out float o_depth;

vec3 ambient(vec3 n) {
    vec3 d = vec3(n.x, n.z, -n.y);    // Z up to the y-up frame of the coefficients
    vec3 e = u_ambient[0] * 0.282095
        + 0.6667 * 0.488603 * (u_ambient[1] * d.y + u_ambient[2] * d.z + u_ambient[3] * d.x)
        + 0.25 * (1.092548 * (u_ambient[4] * d.x * d.y + u_ambient[5] * d.y * d.z + u_ambient[7] * d.x * d.z)
        + 0.315392 * u_ambient[6] * (3.0 * d.z * d.z - 1.0) + 0.546274 * u_ambient[8] * (d.x * d.x - d.y * d.y));
    return max(e, vec3(0.25) * u_ambient[0] * 0.282095);
}
vec4 faded(sampler2D image, vec4 texel) {   // towards the mean, which the coarsest level of the texture holds
    return vec4(mix(textureLod(image, vec2(0.5), 20.0).rgb, texel.rgb, u_contrast), texel.a);
}
vec4 box_mapped(sampler2D image, vec3 normal, float tile) {
    vec3 a = abs(normal);
    vec3 p = v_world / tile, dx = dFdx(p), dy = dFdy(p);
    vec4 x = vec4(p.y, -p.z, dx.y, -dx.z), y = vec4(p.x, -p.z, dx.x, -dx.z), z = vec4(p.xy, dx.xy);
    bool is_z = a.z > a.x && a.z > a.y, is_x = a.x > a.y;
    vec4 chosen = is_z ? z : is_x ? x : y;
    vec2 chosen_dy = is_z ? dy.xy : is_x ? vec2(dy.y, -dy.z) : vec2(dy.x, -dy.z);
    // The level comes from the chosen plane: automatic derivatives would jump where neighbours choose another.
    return textureGrad(image, chosen.xy, chosen.zw, chosen_dy);
}
void main() {
    vec3 normal = normalize(v_normal);
#if MODE == 1
    vec4 base = faded(u_texture, texture(u_texture, v_uv / u_tiles.x));
    base = mix(base, faded(u_texture1, texture(u_texture1, v_uv / u_tiles.y)), v_uv2.x);
    vec4 texel = vec4(mix(base, faded(u_texture2, texture(u_texture2, v_uv / u_tiles.z)), v_uv2.y).rgb, 1.0);
#elif MODE == 2
    vec4 texel = faded(u_texture, box_mapped(u_texture, normal, u_tiles.x));
#else
    vec4 texel = faded(u_texture, texture(u_texture, v_uv / u_tiles.x));
#endif
#if CUT
    if (texel.a < 0.5) discard;
#endif
    vec3 albedo = texel.rgb * texel.rgb * u_tint;
#if MIRROR == 2
    albedo *= 0.1;    // the room behind the glass
#endif
#if DETAIL
    float fine = dot(box_mapped(u_detail, normal, u_detail_tile).rgb, vec3(0.333));
    albedo *= max(1.0 + u_detail_strength * u_contrast * (fine / u_detail_mean - 1.0), 0.2);
#endif
    vec3 to_eye = normalize(u_eye - v_world);
    if (dot(normal, to_eye) < 0.0) normal = -normal;   // models are double-sided
    float facing = max(dot(normal, u_sun), 0.0);
    float lit = texture(u_shadow_map, v_shadow - vec3(0.0, 0.0, 0.0008));
    vec3 aside = abs(v_shadow - 0.5);
    if (max(aside.x, max(aside.y, aside.z)) > 0.5) lit = 1.0;   // the map covers the site only
    vec3 light = u_sheltered * ambient(normal);
#if AO
    light *= texture(u_ao, v_uv2).r;
#endif
    light += u_sun_colour * lit * facing;
    float glint = u_gloss * lit * pow(max(dot(normal, normalize(u_sun + to_eye)), 0.0), 24.0);
    vec3 colour = (albedo * light + u_sun_colour * glint) * u_exposure;
    colour = mix(u_haze_colour, colour, exp(-u_haze * v_depth));
    colour = sqrt(colour / (1.0 + 0.25 * colour));
#if MIRROR == 1    // u_waves: their wavelength in metres, their slope, and how far a slope moves what is mirrored
    vec2 p = v_world.xy * 6.2831853 / u_waves.x;
    vec2 slope = u_waves.y * (sin(p.yx * 0.9 + 2.0 * sin(p * 0.37)) + 0.6 * sin(p * 2.3 + p.yx * 1.1));
    float share = 0.04 + 0.96 * pow(1.0 - abs(dot(normalize(vec3(slope, 1.0)), to_eye)), 5.0);
    vec2 at = gl_FragCoord.xy / vec2(textureSize(u_mirror, 0)) + u_waves.z * slope;
    vec3 mirrored = textureLod(u_mirror, at, 0.0).rgb;
#elif MIRROR == 2
    float share = 0.1 + 0.9 * pow(1.0 - abs(dot(normal, to_eye)), 5.0);
    vec3 mirrored = textureLod(u_sky, sky_uv(reflect(-to_eye, normal), u_sky_turn), 0.0).rgb;
#endif
#if MIRROR
    colour = sqrt(mix(colour * colour, mirrored * mirrored, share));
#endif
    o_colour = vec4(colour, MIRROR == 0 ? 1.0 : 0.0);    // features on a mirror are none of its surface
    o_depth = v_depth;
}
"""

_DEPTH_FRAGMENT = """
uniform sampler2D u_texture; uniform vec3 u_tiles;
in vec2 v_uv; in float v_depth;
layout(location = 0) out vec4 o_colour; layout(location = 1) out float o_depth;
void main() {
#if CUT
    if (texture(u_texture, v_uv / u_tiles.x).a < 0.5) discard;
#endif
    o_colour = vec4(0.0); o_depth = v_depth;
}
"""
FRAGMENTS = {"colour": _COLOUR_FRAGMENT, "depth": _DEPTH_FRAGMENT}

SKY_VERTEX = """
#version 330
out vec2 v_ndc;
void main() {
    v_ndc = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    gl_Position = vec4(v_ndc, 1.0, 1.0);
}
"""

SKY_FRAGMENT = "#version 330" + _SKY_UV + """
uniform sampler2D u_texture; uniform mat3 u_world_from_ndc; uniform float u_turn;
in vec2 v_ndc;
layout(location = 0) out vec4 o_colour; layout(location = 1) out float o_depth;
void main() {
    vec3 d = normalize(u_world_from_ndc * vec3(v_ndc, 1.0));
    o_colour = vec4(textureLod(u_texture, sky_uv(d, u_turn), 0.0).rgb, 1.0);
    o_depth = 0.0;
}
"""
