"""Registries: one name, one small file, one line.

An entry is the text `module:attribute`; the module is imported when the entry is first used, so that listing what
there is costs nothing and a heavy package is loaded only by those who need it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from realsim.core.errors import RealsimError, UnknownNameError


class Registry(Mapping[str, Any]):
    """Names to lazily imported objects, in the order in which they were written down.

    Args:
        kind: what the entries are, for the message about an unknown name.
        entries: name -> "package.module:attribute".
        group: entry points of this group, of any package that is installed, come after the entries; no entry is
            replaced by one.
        otherwise: what to do about a name that is like none of the entries.
        of: "module:class" that an entry of such a package must be an instance of.
    """

    def __init__(
        self, kind: str, entries: Mapping[str, str], group: str = "", of: str = "", otherwise: str = ""
    ) -> None:
        self.kind = kind
        self.group = group
        self.of = of
        self.otherwise = otherwise
        self.own = dict(entries)

    @cached_property
    def _entries(self) -> dict[str, str]:
        """Looked up when first used: a list of what is installed takes some milliseconds."""
        installed = {point.name: point.value for point in entry_points(group=self.group)} if self.group else {}
        return {**self.own, **{name: value for name, value in installed.items() if name not in self.own}}

    def __getitem__(self, name: str) -> Any:
        if name not in self._entries:
            otherwise = self.otherwise
            if self.group and not otherwise:
                otherwise = f"install the package that adds it (entry point of the group {self.group})"
            raise UnknownNameError(self.kind, name, self._entries, otherwise=otherwise or "give one of these names")
        if name in self.own:
            return load_entry(self.own[name])
        with installed(self.kind, name, self._entries[name], self.group):
            found = load_entry(self._entries[name])
            if self.of and not isinstance(found, load_entry(self.of)):
                raise TypeError(f"{repr(found)[:80]} is no {self.of}")
        return found

    def joined(self, more: Mapping[str, str]) -> Registry:
        """This registry with further entries; its own win."""
        return Registry(self.kind, {**more, **self._entries})

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)


@contextmanager
def installed(kind: str, name: str, place: str, group: str) -> Iterator[None]:
    """Whatever goes wrong while an entry point of somebody else's package is imported, as a message that names it."""
    try:
        yield
    except RealsimError:
        raise
    except Exception as error:
        raise RealsimError(
            f"the {kind} {name!r} of an installed package cannot be loaded",
            expected=f"{place} (entry point of the group {group})",
            found=f"{type(error).__name__}: {error}",
            hint="mend that package and install it again, or uninstall it",
        ) from error


def load_entry(place: str) -> Any:
    """What "module:attribute" names."""
    module, _, attribute = place.partition(":")
    return getattr(import_module(module), attribute)


def lazily(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """A package's `__getattr__` (PEP 562): what it offers is imported when it is first used, and kept.

    Args:
        package: the package's `__name__`.
        homes: name -> module that has it.
    """

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(homes[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return get
