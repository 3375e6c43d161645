"""Every output of every command in every test is held to its schema (`realsim schema COMMAND`)."""

import json
from collections.abc import Mapping
from typing import Any

from jsonschema import Draft202012Validator

from realsim.cli import schemas
from realsim.cli.command_line import answer
from realsim.cli.table import commands
from realsim.core.files import to_json


def check(command: str, data: Mapping[str, Any]) -> None:
    """Fails where an output is not as its schema says, or has a key that the schema does not know."""
    schema = schemas.load(command, commands()[command].package)
    if schema is None:
        return
    said = json.loads(to_json(answer(command, data)))
    errors = sorted(Draft202012Validator(schema).iter_errors(said), key=str)
    assert not errors, "\n".join(_why(error) for error in errors)
    fitting = [
        part
        for part in (_resolved(part, schema) for part in schema["anyOf"])
        if Draft202012Validator({**part, "$defs": schema["$defs"]}).is_valid(said)
    ]
    unknown = set(said).difference(*(part["properties"] for part in fitting))
    assert not unknown, f"the schema of {command} does not know {sorted(unknown)}"


def _resolved(part: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    return schema["$defs"][part["$ref"].rpartition("/")[2]] if "$ref" in part else part


def _why(error: Any) -> str:
    parts = [f"{list(e.absolute_path)}: {e.message[:300]}" for e in error.context or [error]]
    return "\n".join(parts)
