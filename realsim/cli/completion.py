"""Completion of commands and options in a shell: `realsim --completion bash|zsh|fish` prints the script."""

from collections.abc import Callable, Mapping

from realsim.cli.options import options_of
from realsim.cli.table import commands
from realsim.core.errors import UnknownNameError

Words = Mapping[str, list[str]]
"""Command -> its options."""


def script(shell: str) -> str:
    """The completion script of a shell, of all commands that are installed."""
    if shell not in SHELLS:
        raise UnknownNameError("shell", shell, SHELLS)
    words = {}
    for name, command in commands().items():
        options = options_of(command.load())[1]
        words[name] = sorted({flag for option in options for flag in option.names} | {"--help", "--json", "--quiet"})
    return SHELLS[shell](words)


def _bash(words: Words) -> str:
    cases = "\n".join(f"    {name}) words='{' '.join(flags)}' ;;" for name, flags in words.items())
    return f"""# realsim --completion bash > ~/.local/share/bash-completion/completions/realsim
_realsim() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" words=''
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W '{" ".join(words)} help --version' -- "$current"))
    return
  fi
  if [ "${{COMP_WORDS[1]}}" = help ]; then
    COMPREPLY=($(compgen -W '{" ".join(words)}' -- "$current"))
    return
  fi
  case "${{COMP_WORDS[1]}}" in
{cases}
  esac
  case "$current" in
    -*) COMPREPLY=($(compgen -W "$words" -- "$current")) ;;
    *) compopt -o filenames 2>/dev/null; COMPREPLY=($(compgen -f -- "$current")) ;;
  esac
}}
complete -F _realsim realsim
"""


def _zsh(words: Words) -> str:
    return "# realsim --completion zsh > ~/.realsim-completion; source it in ~/.zshrc\n" + (
        "autoload -Uz compinit bashcompinit && compinit -u && bashcompinit\n" + _bash(words)
    )


def _fish(words: Words) -> str:
    lines = ["# realsim --completion fish > ~/.config/fish/completions/realsim.fish"]
    first = "complete -c realsim -f -n __fish_use_subcommand -a"
    lines += [f"{first} '{name}' -d '{_quoted(commands()[name].summary)}'" for name in words]
    for name, flags in words.items():
        seen = f"complete -c realsim -n '__fish_seen_subcommand_from {name}' -l"
        lines += [f"{seen} {flag[2:]}" for flag in flags]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace("'", "\\'")


SHELLS: dict[str, Callable[[Words], str]] = {"bash": _bash, "zsh": _zsh, "fish": _fish}
