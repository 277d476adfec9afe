# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker's commands and their arguments, as the options declare them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import Field, fields
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from ..base.options import (
    CHECK,
    COMPARE,
    COMPARE_WAYS,
    CONTROL,
    DICTIONARIES,
    EXPORT,
    FORMATS,
    FRAMES,
    GAPS,
    LIBRARIES,
    LOCAL,
    LOCATIONS,
    MASK,
    PLACEMENTS,
    PLAN,
    PUBLISH,
    REPORT,
    RUN,
    SELF_CHECK,
    STAGES,
    SURFACE,
    SURFACE_STAGES,
    TOKEN_VARIABLE,
    UPLOAD,
    Argument,
    Options,
    declared,
)
from ..base.reading import FARTHEST
from ..plan.drones import DRONES
from ..plan.wishes import KINDS, MOST_PHOTOS, Wishes

if TYPE_CHECKING:
    from ..deliver.write import Choices
    from ..publish.records import About

EXIT_CODES = """exit codes:
  0  done                     5  workspace: read-only, full, in use, newer
  1  a fault in CU-Recon      6  weights missing or corrupted
  2  wrong arguments          7  device not there, or memory budget too small
  3  photos unusable          8  no point that enough views agree on
  4  cameras not found        9  a library is missing from this Python
 10  no mesh or no texture can be made     11  out of memory
 12  control points unusable          13  nothing of that format can be made of the site
 14  no flight can be planned         15  nothing can be published of the site, or not there
 16  results that cannot be compared      17  the atlas does not answer, or does not take the site
130  cancelled
"""


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    main = argparse.ArgumentParser(
        prog="python -m curecon_blender.core", description="From drone photos to a coloured, measured point cloud.",
        epilog=EXIT_CODES, formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    main.add_argument("--messages", action="store_true", help="speak the add-on's protocol")
    commands = main.add_subparsers(dest="command", required=True)

    def command(name: str, help: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=help, epilog=EXIT_CODES,
                                    formatter_class=argparse.RawDescriptionHelpFormatter)
        for option, argument in declared(name):
            _add(added, option, argument)
        added.add_argument("--json", action="store_true", help="print a JSON summary as the last line")
        return added

    run = command(RUN, "photos to cloud; run it again to go on or to do nothing")
    run.add_argument("photos", type=Path, help="folder of photos (JPEG, PNG, TIFF, HEIC, raw)")
    run.add_argument("--workspace", type=Path, required=True, help="folder for everything that is made")
    run.add_argument("--until", choices=STAGES, default=Options.until, help="stop after this stage")
    surface = command(SURFACE, "mesh and texture of a workspace whose cloud is finished")
    surface.set_defaults(photos=None)
    surface.add_argument("workspace", type=Path)
    surface.add_argument("--until", choices=SURFACE_STAGES, default=SURFACE_STAGES[-1], help="stop after this stage")
    check = command(CHECK, "look at the photos and say what each quality would cost")
    check.add_argument("photos", type=Path)
    check.add_argument("--workspace", type=Path, help="where the job would be kept, for its disk's free space")
    check.add_argument("--thumbnails", type=Path, metavar="FOLDER",
                       help="folder for small pictures of blurred and badly exposed photos")
    control = command(CONTROL, "control points of a workspace: import, find coded targets in the photos, export")
    control.add_argument("workspace", type=Path)
    control.add_argument("--import", dest="imported", type=Path, nargs="+", default=[], metavar="FILE",
                         help="files of points and marks: ODM, Pix4D, Metashape, or name,x,y,z")
    control.add_argument("--system", default="", help="what their coordinates are in where they do not say so")
    control.add_argument("--find-targets", action="store_true",
                         help="mark the points whose names end in the number of a coded target (ArUco)")
    control.add_argument("--dictionary", choices=DICTIONARIES, default=DICTIONARIES[0], help="which targets they are")
    control.add_argument("--export", type=Path, metavar="FILE", help="write points and marks as ODM's gcp_list.txt")
    report = command(REPORT, "clearness, accuracy, integrity and authenticity of a workspace, as PDF, HTML and JSON")
    report.add_argument("workspace", type=Path)
    report.add_argument("--name", default="", help="the site's name (default: the photos' folder)")
    report.add_argument("--by", default="", help="who made the record")
    report.add_argument("--when", default="", help="the date of the record")
    report.add_argument("--language", default="", metavar="NAME", help="such as zh_HANS; default: English")
    report.add_argument("--font", type=Path, metavar="FILE", help="TTF, OTF or WOFF2, for letters that are not Latin")
    command(FRAMES, "photos from the videos (MP4, MOV) in a folder, each into a folder beside it").add_argument(
        "photos", type=Path, help="folder with the videos")
    _plan(command(PLAN, "a flight for a building, before there are photos: page, DJI and Litchi missions, KML, GPX"))
    _gaps(command(GAPS, "what of a finished site too few photos saw, and where to fly again"))
    _mask(command(MASK, "what lies in a solid of the site is left out of all photos from the next run on"))
    _libraries(command(LIBRARIES, "bring the worker's libraries, as a lock names them, into a folder for PYTHONPATH"))
    _export_arguments(command(EXPORT, "the finished site in surveyors' formats"))
    _publish(command(PUBLISH, "the finished site as a folder of web pages, with a map of all sites in it"),
             command(UPLOAD, f"a published site to an atlas; the token for it stands in {TOKEN_VARIABLE}"))
    _compare(command(COMPARE, "other programs' results beside ours: distances, a sheet, change between dates"))
    command(SELF_CHECK, "reconstruct synthetic views, and say what this computer has")
    return main


def _libraries(libraries: argparse.ArgumentParser) -> None:
    libraries.add_argument("folder", type=Path)
    libraries.add_argument("--locks", type=Path, required=True, help="folder of lock files")
    libraries.add_argument("--index", nargs="+", default=[], metavar="ADDRESS",
                           help="package indexes in place of pypi.org and pytorch.org")
    libraries.add_argument("--processor", action="store_true", help="those for the processor, with an NVIDIA card too")


def _plan(plan: argparse.ArgumentParser) -> None:
    """The arguments of the flight planner, whose record is plan.records.Wishes."""
    plan.add_argument("folder", type=Path, help="where the plan's files are written")
    plan.add_argument("--kind", choices=sorted(KINDS), default="building", help="of building, or the form to fly")
    plan.add_argument("--drone", choices=sorted(DRONES), default="mini4pro", help="which drone flies")
    where = plan.add_mutually_exclusive_group(required=True)
    where.add_argument("--outline", type=Path, metavar="FILE",
                       help="polygon drawn on a map, GeoJSON or KML; its hole is the court")
    where.add_argument("--size", type=_metres, nargs=2, metavar=("WIDTH", "DEPTH"), help="of a rectangular building")
    where.add_argument("--ring", type=_metres, nargs=2, metavar=("OUTER", "INNER"), help="diameters of a ring")
    where.add_argument("--workspace", type=Path, help="plan for the cloud of this workspace")
    plan.add_argument("--turn", type=float, default=0.0, help="heading of the depth, degrees clockwise from north")
    plan.add_argument("--position", type=float, nargs=2, metavar=("LATITUDE", "LONGITUDE"),
                      help="of the building's middle, degrees")
    plan.add_argument("--height", type=_metres, help="of the building's highest part, metres")
    plan.add_argument("--eaves", type=_metres, help="height of its walls, metres")
    plan.add_argument("--name", default="", help="what the plan is called on the page")
    plan.add_argument("--pixel", type=_metres, default=Wishes.pixel, metavar="MM",
                      help="wanted millimetres a pixel on the building")
    _limits(plan)
    for field, text in (("forward", "the photo before"), ("side", "the neighbouring line")):
        plan.add_argument(f"--{field}", type=_percent, default=100 * getattr(Wishes, field), metavar="PERCENT",
                          help=f"overlap with {text}")
    plan.add_argument("--above", type=_metres, help="metres of grids above the building, in place of --pixel")
    plan.add_argument("--camera", type=_metres, nargs=5, metavar=("W_MM", "H_MM", "FOCAL_MM", "W_PX", "H_PX"),
                      help="a camera that is not in the table")
    plan.add_argument("--minutes", type=_metres, help="of one battery, in place of the table's")
    plan.add_argument("--waypoints", type=int, help="that the flight app takes at once, in place of the table's")


def _gaps(gaps: argparse.ArgumentParser) -> None:
    gaps.add_argument("workspace", type=Path)
    gaps.add_argument("--photos", type=int, choices=range(1, MOST_PHOTOS + 1), default=MOST_PHOTOS, metavar="COUNT",
                      help=f"most photos to ask for, up to {MOST_PHOTOS} (default: %(default)s)")
    gaps.add_argument("--drone", choices=sorted(DRONES), help="which drone flies (default: the photos' own camera)")
    _limits(gaps)


def _mask(mask: argparse.ArgumentParser) -> None:
    mask.add_argument("workspace", type=Path)
    what = mask.add_mutually_exclusive_group(required=True)
    what.add_argument("--solid", type=Path, metavar="FILE",
                      help="closed mesh in the site's frame, such as a box: PLY, OBJ or GLB")
    what.add_argument("--clear", action="store_true", help="take all masks away that were made so")


def _limits(command: argparse.ArgumentParser) -> None:
    """What a flight must keep to."""
    for field, text in (("clearance", "least distance to anything"),
                        ("ceiling", "greatest height above take-off")):
        command.add_argument(f"--{field}", type=_metres, default=getattr(Wishes, field), metavar="METRES", help=text)
    command.add_argument("--takeoff", type=float, nargs=3, default=Wishes.takeoff, metavar=("EAST", "NORTH", "UP"),
                         help="take-off, metres from the building's middle and above its ground")


def _compare(compare: argparse.ArgumentParser) -> None:
    """The arguments of the comparison, whose record is compare.write.Wishes."""
    compare.add_argument("ours", type=Path, help="workspace, or file")
    compare.add_argument("others", type=Path, nargs="*", help="PLY, LAS, LAZ, E57, OBJ, GLB, XYZ, or dense workspace")
    compare.add_argument("--truth", type=Path, metavar="FILE", help="measure all by this, in our coordinates")
    compare.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="for sheet, figures and clouds")
    compare.add_argument("--by", choices=COMPARE_WAYS, default=COMPARE_WAYS[0],
                         help="how the others are laid on ours (default: %(default)s)")
    compare.add_argument("--pairs", type=Path, nargs="+", default=[], metavar="FILE",
                         help="for each other, lines of x y z in it and x y z in ours")
    compare.add_argument("--scale", action="store_true", help="find the others' scale, too")
    compare.add_argument("--thresholds", type=_metres, nargs="+", default=[0.05, 0.1], metavar="METRES",
                         help="of precision and completeness (default: 0.05 0.1)")
    compare.add_argument("--names", nargs="+", default=[], help="of ours and the others")
    compare.add_argument("--minutes", type=float, nargs="+", default=[], help="that ours and the others took")
    compare.add_argument("--change", action="store_true", help="the others are later: what came, and what fell down")
    compare.add_argument("--registration", type=float, metavar="METRES",
                         help="standard deviation of how one date lies on the other")


def _metres(text: str) -> float:
    """A positive number up to 100 km."""
    value = float(text)
    if not 0 < value <= 100_000:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def _percent(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 95:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 95")
    return value
def _export_arguments(export: argparse.ArgumentParser) -> None:
    export.add_argument("workspace", type=Path)
    export.add_argument("--format", choices=FORMATS, nargs="+", required=True, help="what to write")
    export.add_argument("--frame", choices=PLACEMENTS, default=LOCAL,
                        help="local: nothing tells where the site is; site: the same coordinates, and where their "
                        "origin lies; utm: easting, northing, altitude (default: %(default)s)")
    export.add_argument("--to", type=Path, metavar="FOLDER",
                        help="an empty folder (default: deliverables/FRAME in the workspace)")
    size = Argument(flag="", help="", least=0, above=True, most=FARTHEST)
    export.add_argument("--pixel", type=_within(float, size), metavar="METRES",
                        help="side of a pixel of pictures and heights (default: as fine as what was measured)")
    export.add_argument("--interval", type=_within(float, size), metavar="METRES", help="between two contours")
    place = Argument(flag="", help="", least=-FARTHEST, most=FARTHEST)
    export.add_argument("--plan", type=_within(float, place), nargs="+", default=[], metavar="HEIGHT",
                        help="level cuts at these heights above the site's zero, in metres")
    export.add_argument("--section", type=_within(float, place), nargs=4, action="append", default=[],
                        metavar=("X0", "Y0", "X1", "Y1"),
                        help="an upright cut between two places of the site frame; once for each cut")
    export.add_argument("--turn", type=_within(float, Argument(flag="", help="", least=-360, most=360)),
                        metavar="DEGREES", help="of the facades, anticlockwise from x (default: as the walls stand)")
    export.add_argument("--licence", default="", help="written into each file")
    export.add_argument("--credit", default="", help="written into each file")


def _publish(publish: argparse.ArgumentParser, upload: argparse.ArgumentParser) -> None:
    publish.add_argument("workspace", type=Path)
    publish.add_argument("folder", type=Path, help="empty, or one that was published into: the site is added there")
    publish.add_argument("--location", choices=LOCATIONS, required=True,
                         help="what the public is told of where the site is: the exact place, a fixed square of 1 km, "
                         "or nothing")
    publish.add_argument("--title", default="", help="the site's name (default: the workspace's)")
    publish.add_argument("--text", default="", help="what it is, in a few sentences")
    publish.add_argument("--place", default="", help="where it is in words, such as the country; shown as it is")
    publish.add_argument("--licence", default="", help="on which terms it is published")
    publish.add_argument("--credit", default="", help="whose record it is")
    publish.add_argument("--notes", type=Path, metavar="FILE",
                         help="notes on the site: JSON, a list of title, text, place and eye in the site frame")
    publish.add_argument("--part", type=int, default=1, metavar="NUMBER",
                         help="which part, of a site whose parts do not connect (default: %(default)s)")

    upload.add_argument("folder", type=Path, help="that was published into")
    upload.add_argument("--to", required=True, metavar="ADDRESS", help="of the atlas")
    upload.add_argument("--site", default="", metavar="NAME", help="its folder's name, where there are several sites")
    upload.add_argument("--tags", default="", help="that it is found by, with commas between")
    upload.add_argument("--register", default="", metavar="NUMBER", help="in a heritage register")
    upload.add_argument("--period", type=int, nargs=2, metavar=("FROM", "TO"), help="years, before our era below zero")
    upload.add_argument("--language", default="", metavar="NAME", help="of the atlas's answers, such as zh_HANS")


def about_of(given: argparse.Namespace) -> About:
    """What parsed arguments say of a site to be published. Raises WorkspaceError."""
    from ..publish.records import About, read_notes

    return About(
        title=given.title or given.workspace.absolute().name.removesuffix("_curecon").replace("_", " "),
        location=given.location, text=given.text, place=given.place, credit=given.credit, licence=given.licence,
        notes=read_notes(given.notes) if given.notes else (),
    )


def choices_of(given: argparse.Namespace) -> Choices:
    """How parsed arguments want the deliverables."""
    from ..deliver.write import Choices

    return Choices(
        pixel=given.pixel, interval=given.interval, plans=tuple(given.plan),
        sections=tuple((x0, y0, x1, y1) for x0, y0, x1, y1 in given.section),
        turn=None if given.turn is None else radians(given.turn), licence=given.licence, credit=given.credit,
    )


def options_of(given: argparse.Namespace) -> Options:
    """The record that parsed arguments give."""
    values = {option.name: getattr(given, option.name) for option in fields(Options) if hasattr(given, option.name)}
    values = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    return Options(**{**values, "workspace": given.workspace or given.photos})


def _add(parser: argparse.ArgumentParser, option: Field[Any], argument: Argument) -> None:
    hint = get_type_hints(Options)[option.name]
    kind = next((part for part in get_args(hint) if part is not type(None)), hint)
    facts: dict[str, Any] = {"dest": option.name, "default": option.default, "help": argument.help.replace("%", "%%")}
    if kind is bool:
        facts["action"] = argparse.BooleanOptionalAction if option.default else "store_true"
    elif argument.choices:
        facts |= {"choices": argument.choices} | ({"nargs": "+"} if argument.many else {})
    elif argument.parts:
        facts |= {"type": float, "nargs": len(argument.parts), "metavar": argument.parts}
    elif argument.many:
        facts |= {"type": kind, "nargs": "+", "metavar": argument.unit.upper()}
    else:
        facts |= {"type": _within(kind, argument), "metavar": argument.unit.upper() or None}
    parser.add_argument(argument.flag, **facts)


def _within(kind: type, argument: Argument) -> Callable[[str], Any]:
    """Reads a value, and refuses a number that is not in the range declared."""

    def read(text: str) -> Any:
        value = kind(text)
        if argument.least is not None and not (value > argument.least if argument.above else value >= argument.least):
            bound = f"above {argument.least:g}" if argument.above else f"at least {argument.least:g}"
            raise argparse.ArgumentTypeError(f"{text} is not {bound}")
        if argument.most is not None and not value <= argument.most:
            raise argparse.ArgumentTypeError(f"{text} is more than {argument.most:g}")
        return value

    read.__name__ = kind.__name__  # argparse names it when a text cannot be read
    return read
