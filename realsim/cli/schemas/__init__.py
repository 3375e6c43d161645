"""JSON Schemas of what commands print with `--json`: one file a command, `common.json` for what several share.

A file holds a version and the outputs that the command may have. The version is part of the `schema` that every output
names first; it goes up when something is taken away or means something else, not when something is added.
Another package that adds commands has their files in `schemas/` of its top package.
"""

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

DIALECT = "https://json-schema.org/draft/2020-12/schema"
ERROR = "realsim.error/1"


def name_of(command: str, package: str = "realsim") -> str | None:
    """`realsim.COMMAND/VERSION`, what the command's output names as its `schema`; None if it has none."""
    data = _read(command, package)
    return None if data is None else f"realsim.{command}/{data['version']}"


def load(command: str, package: str = "realsim") -> dict[str, Any] | None:
    """The schema of a command, complete in itself; None if it has none.

    Args:
        package: top package that adds the command.
    """
    data, name = _read(command, package), name_of(command, package)
    common = _read("common", "realsim")
    if data is None or name is None or common is None:
        return None
    error = common.pop("error")
    return {
        "$schema": DIALECT,
        "$id": f"urn:realsim:{command}:{data['version']}",
        "title": f"realsim {command} --json",
        "description": data["description"],
        "anyOf": [*(_named(output, name) for output in data["outputs"]), _named(error, ERROR)],
        "$defs": {key: _named(part, name) if key == "many" else part for key, part in common.items()},
    }


def _named(output: dict[str, Any], name: str) -> dict[str, Any]:
    """An output that says which schema it has."""
    if "$ref" in output:
        return output
    properties = {"schema": {"const": name}, **output["properties"]}
    return {**output, "properties": properties, "required": ["schema", *output["required"]]}


def _read(name: str, package: str) -> dict[str, Any] | None:
    if package == "realsim":
        folders = [Path(__file__).parent]
    else:
        spec = find_spec(package)
        folders = [Path(place) / "schemas" for place in (spec and spec.submodule_search_locations) or ()]
    file = next((path for folder in folders if (path := folder / f"{name}.json").is_file()), None)
    return None if file is None else json.loads(file.read_text(encoding="utf-8"))
