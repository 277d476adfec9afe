# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The atlas's commands. Each takes the configuration file, which `init` writes."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from sqlalchemy.exc import DBAPIError

from curecon_blender.core.base.errors import WorkspaceError

from . import backup, configuration, local, operation, people, server, surveys
from .problems import Problem


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m atlas", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)

    def command(name: str, help: str) -> argparse.ArgumentParser:
        made = commands.add_parser(name, help=help)
        made.add_argument("configuration", type=Path)
        return made

    command("init", "write a new configuration, with a key of its own")
    command("serve", "serve the atlas until it is told to end")
    command("invite", "an invitation's link, to make an account by").add_argument(
        "role", choices=people.ROLES, nargs="?", default=people.MODERATOR)
    command("survey", "let a questionnaire's answers come in, and tell where to").add_argument("name")
    command("add", "publish a site's folder without the network").add_argument("site", type=Path)
    command("backup", "write all of it into a new folder").add_argument("folder", type=Path)
    command("restore", "bring a backup into an atlas that is empty").add_argument("folder", type=Path)
    command("export", "copy what is public into a new folder, for any web server").add_argument("folder", type=Path)
    command("rebuild", "write all static files anew, as after an update")
    command("demo", "an atlas on this computer with a published folder's sites in it").add_argument("folder", type=Path)
    given = parser.parse_args(arguments)
    try:
        _run(given)
    except (configuration.ConfigurationError, Problem, DBAPIError, WorkspaceError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _run(given: argparse.Namespace) -> None:
    """Raises ConfigurationError, FileExistsError, Problem."""
    if given.command == "init" or (given.command == "demo" and not given.configuration.exists()):
        configuration.write_new(given.configuration)
    if given.command == "init":
        return
    operation.start_log()
    parts = server.assemble(configuration.read(given.configuration))
    if given.command == "survey":
        with parts.database.write() as transaction:
            surveys.open_survey(transaction, given.name, local.CONSOLE.id)
        print(f"{parts.configuration.address}/api/surveys/{given.name}/answers")
    if given.command == "add":
        print(local.add(parts, given.site))
    if given.command == "backup":
        print(f"{backup.backup(parts, given.folder.absolute())} files")
    if given.command == "restore":
        print(f"{backup.restore(parts, given.folder.absolute())} files")
        parts.publisher.rebuild()
    if given.command == "export":
        print(f"{backup.export(parts, given.folder.absolute())} files")
    if given.command == "rebuild":
        parts.publisher.rebuild()
    if given.command == "demo":
        parts.publisher.write_pages()
        with parts.database.read() as transaction:
            empty = not transaction.value("SELECT count(*) FROM site")
        for site in sorted((given.folder / "sites").iterdir()) if empty else []:
            try:
                local.add(parts, site)
            except Problem as problem:
                print(f"{site} is left out: {problem}", file=sys.stderr)
    if given.command in ("invite", "demo"):
        with parts.database.write() as transaction:
            token = people.invite(transaction, getattr(given, "role", people.MODERATOR), local.CONSOLE.id)
        print(f"{parts.configuration.address}/desk/#join={token}", flush=True)
    if given.command in ("serve", "demo"):
        server.serve(parts)


if __name__ == "__main__":
    sys.exit(main())
