"""Every output of every command in every test is held to its schema (`realsim schema COMMAND`)."""

import json
from collections.abc import Mapping
from functools import cache
from typing import Any

from jsonschema import Draft202012Validator

from realsim.cli import schemas
from realsim.cli.command_line import answer
from realsim.cli.table import commands
from realsim.core.files import to_json


def check(command: str, data: Mapping[str, Any]) -> None:
    """Fails where an output is not as its schema says, or has a key that the schema does not know."""
    if not (parts := _parts(command)):
        return
    said = json.loads(to_json(answer(command, data)))
    known = [keys for keys, validator in parts if validator.is_valid(said)]
    errors = [] if known else [error for _, validator in parts for error in validator.iter_errors(said)]
    assert known, "\n".join(_why(error) for error in sorted(errors, key=str))
    unknown = set(said).difference(*known)
    assert not unknown, f"the schema of {command} does not know {sorted(unknown)}"


@cache
def _parts(command: str) -> list[tuple[set[str], Draft202012Validator]]:
    """(keys, their validator) of each form that the output of a command may have; none without a schema."""
    schema = schemas.load(command, commands()[command].package)
    parts = [] if schema is None else [_resolved(part, schema) for part in schema["anyOf"]]
    return [(set(p["properties"]), Draft202012Validator({**p, "$defs": schema["$defs"]})) for p in parts]


def _resolved(part: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    return schema["$defs"][part["$ref"].rpartition("/")[2]] if "$ref" in part else part


def _why(error: Any) -> str:
    parts = [f"{list(e.absolute_path)}: {e.message[:300]}" for e in error.context or [error]]
    return "\n".join(parts)
