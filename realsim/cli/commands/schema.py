"""`realsim schema`: what a command prints with `--json`."""

from typing import Annotated

import tyro

from realsim.cli import schemas
from realsim.cli.commands import CommandResult
from realsim.core.errors import RealsimError
from realsim.core.files import to_json


def schema(command: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="COMMAND")] = "") -> CommandResult:
    """Print the JSON Schema of a command's --json output, or list the schemas of all commands.

    Args:
        command: as in `realsim COMMAND`; all are listed if none is given.
    """
    from realsim.cli.table import commands, find

    if not command:
        names = {name: schemas.name_of(name, known.package) for name, known in commands().items()}
        found = {name: text for name, text in names.items() if text is not None}
        return CommandResult("\n".join(found.values()), {"schemas": found})
    data = schemas.load(command, find(command).package)
    if data is None:
        raise RealsimError(
            "the command has no schema", expected=f"schemas/{command}.json in its package", hint="realsim schema"
        )
    return CommandResult(to_json(data).rstrip(), {"command": command, "json_schema": data})
