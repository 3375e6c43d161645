"""The options of a command, made from its function's parameters. All that is known of tyro, which parses them, is here.

tyro's own boxes are never shown: what options there are is read from the parser that it makes, and what is wrong with
arguments from the events that it reports. Both are outside of its stable interface, so pyproject.toml bounds its
version, and tests/cli/test_options.py says what is relied on.
"""

import functools
import inspect
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import takewhile
from typing import Any

from realsim.core.errors import RealsimError


class UsageError(RealsimError):
    """Arguments that do not fit the command."""


@dataclass(frozen=True)
class Option:
    """An option, or an argument without a name."""

    names: tuple[str, ...]
    """`--out`; `--report`, `--no-report`; none of a positional argument."""
    parameter: str
    """`out`, or `config.scene.robot` of a nested configuration."""
    value: str
    """What it takes: PATH, {a,b}, FLOAT FLOAT; empty for a switch."""
    help: str
    group: str
    """`general`, `scene`, ...: the part of the configuration that it belongs to; empty for those of the command."""
    required: bool
    several: bool
    """Whether it takes any number of values."""


def options_of(function: Callable[..., Any]) -> tuple[str, list[Option]]:
    """What a command does (its docstring), and its arguments and options in order."""
    import tyro

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        parser = tyro.extras.get_parser(function, config=(tyro.conf.OmitArgPrefixes,), add_help=False)
    found = []
    for group in parser._action_groups:
        for action in group._group_actions:
            names = tuple(action.option_strings)
            if action.nargs == 0 and not action.default:
                names = names[:1]  # a switch that is off needs no name that turns it off
            path = action.dest.replace("-", "_")
            text, needed, several = action.help or "", action.required, action.nargs in ("*", "+")
            found.append(Option(names, path, _value(action), _help(text), _group(path, bool(names)), needed, several))
    return parser.description or "", found


def _value(action: Any) -> str:
    """What an option takes, without the None of one that may be left out."""
    text = str(action.metavar or "").removeprefix("{None}|").replace("{None,", "{")
    # Braces around several values are no choice.
    return text[1:-1] if text.startswith("{") and not {",", "|"} & set(text) else text


def _help(text: str) -> str:
    """Less a default that says nothing."""
    for default in ("(default: None)", "(default: '')", "(default: )", "(default: False)", "(required)"):
        text = text.removesuffix(default)
    return text.strip()


def _group(path: str, named: bool) -> str:
    parts = path.split(".")[:-1]
    return "" if not parts or not named else {"config": "general", "many": "many-inputs"}.get(parts[-1], parts[-1])


def parse(
    function: Callable[..., Any], name: str, arguments: Sequence[str], defaults: Mapping[str, Any] | None = None
) -> functools.partial[Any]:
    """The call of a command with its arguments, not yet made.

    Args:
        name: of the command, for messages.
        defaults: parameter -> value instead of the function's own default.

    Raises:
        UsageError: the arguments do not fit.
    """
    import tyro
    import tyro._errors as events

    if "" in arguments:  # Path("") would be the folder that one is in
        hint = f"is a variable of the shell not set? realsim help {name}"
        raise UsageError("an argument is empty", expected="a path or a value", found='""', hint=hint)
    arguments = _together(function, arguments)

    @functools.wraps(function)
    def later(*args: Any, **given: Any) -> Any:
        return functools.partial(function, *args, **given)

    if defaults:
        signature = inspect.signature(function)
        parameters = [p.replace(default=defaults.get(p.name, p.default)) for p in signature.parameters.values()]
        # A parameter without a default may not follow one with: by keyword, the order is free.
        later.__signature__ = signature.replace(  # type: ignore[attr-defined]
            parameters=[p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
        )

    def refuse(event: Any) -> None:
        raise _usage_error(event, function, name, arguments)

    with events.on_parse_error(refuse):
        call: functools.partial[Any] = tyro.cli(
            later, prog=f"realsim {name}", args=list(arguments), config=(tyro.conf.OmitArgPrefixes,)
        )
    return call


def _together(function: Callable[..., Any], arguments: Sequence[str]) -> list[str]:
    """`--use A --use B` as `--use A B`: of an option that takes several values tyro would keep the last alone."""
    names = [a for a in arguments if a.startswith("--")]
    if len(set(names)) == len(names):
        return list(arguments)
    several = {name for option in options_of(function)[1] if option.several for name in option.names}
    given: dict[str, list[str]] = {}
    rest: list[str] = []
    into = rest
    for argument in arguments:
        if argument in several:
            into = given.setdefault(argument, [])
        else:
            into = rest if argument.startswith("--") else into
            into.append(argument)
    return [*rest, *(part for name, values in given.items() for part in (name, *values))]


def _usage_error(event: Any, function: Callable[..., Any], name: str, arguments: Sequence[str]) -> UsageError:
    """What tyro reports about arguments, in our words."""
    import tyro._errors as events

    known = options_of(function)[1]
    every = f"realsim help {name}"
    if isinstance(event, events.UnrecognizedArgs):
        return _unknown(event.tokens, known, every)
    if isinstance(event, events.MissingArgs):
        missing = [context.arg.display_name() for context in event.missing_arguments]
        if event.unrecognized_tokens:
            return _unknown(event.unrecognized_tokens, known, every)
        needed = " ".join(m if m.startswith("-") else m.upper() for m in missing)
        return UsageError(f"{needed} is missing", expected=f"realsim {name} {needed} ...", hint=every)
    if isinstance(event, events.InvalidChoice):
        close = get_close_matches(event.value, event.choices, n=1, cutoff=0.4)
        choices = [choice for choice in event.choices if choice != "None"]
        return UsageError(
            f"{event.argument.display_name()} does not take {event.value!r}",
            expected=f"one of {', '.join(choices)}",
            found=event.value,
            hint=f"did you mean {close[0]}?" if close else every,
        )
    argument = getattr(event, "argument", None)
    shown = None if argument is None else argument.display_name()
    takes = next((o.value for o in known if shown and shown.split("/")[0] in o.names), None)
    if isinstance(event, events.BadValue):
        return UsageError(
            f"{shown} lacks a value",
            expected=f"{shown} {takes or ''}".rstrip(),
            found=_given(arguments, shown or ""),
            hint=every,
        )
    message = str(getattr(event, "message", "the arguments do not fit"))
    if shown is not None:
        found = _given(arguments, shown)
        apart = f"separate values by spaces: {found.replace(',', ' ')}" if found and "," in found else every
        return UsageError(f"{shown} cannot take this value", expected=takes, found=found or message, hint=apart)
    return UsageError(_with_option_names(message, known), hint=every)


def _given(arguments: Sequence[str], names: str) -> str | None:
    """The words that follow an option on the command line."""
    for i, word in enumerate(arguments):
        name, equals, value = word.partition("=")
        if name.replace("_", "-") in names.split("/"):
            following = [value] if equals else takewhile(lambda w: not w.startswith("--"), arguments[i + 1 : i + 3])
            return " ".join([name, *following])
    return None


def _unknown(tokens: Sequence[str], known: Sequence[Option], every: str) -> UsageError:
    """Words that are no options: the first of them, and what is most like it."""
    first = next((t for t in tokens if str(t).startswith("-")), None)
    if first is None:
        return UsageError("too many arguments", expected="options begin with --", found=" ".join(tokens), hint=every)
    option = first.partition("=")[0]
    names = [name for o in known for name in o.names]
    close = get_close_matches(option.replace("_", "-"), names, n=3, cutoff=0.6)
    hint = f"did you mean {' or '.join(close)}? {every} lists all options" if close else f"{every} lists all options"
    return UsageError(f"unknown option {option}", found=" ".join(tokens), hint=hint)


def _with_option_names(message: str, known: Sequence[Option]) -> str:
    """A configuration's complaint about its fields, with the options' names that people type."""
    flags = {o.parameter.rpartition(".")[2]: o.names[0] for o in known if o.names}

    def flag(match: re.Match[str]) -> str:
        return flags.get(match[0], match[0]) if "_" in match[0] else match[0]

    text = message.strip()
    if text.startswith("Error parsing "):  # tyro names the path of the configuration in the source
        text = text.partition(": ")[2]
    return re.sub(r"\b[a-z]+(?:_[a-z]+)+\b", flag, text)
