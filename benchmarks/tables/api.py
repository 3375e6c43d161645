"""The public functions with their first sentence, for who reads docs/api.md where it is not rendered."""

import inspect

import realsim


def functions() -> list[str]:
    lines = ["| function | |", "|---|---|"]
    for name in realsim.__all__:
        function = getattr(realsim, name)
        if inspect.isfunction(function):
            takes = inspect.signature(function).parameters.values()
            names = [p.name if p.default is p.empty else f"{p.name}=..." for p in takes]
            said = inspect.cleandoc(function.__doc__ or "").split("\n\n")[0].replace("\n", " ")
            lines.append(f"| `rs.{name}({', '.join(names)})` | {said} |")
    return lines
