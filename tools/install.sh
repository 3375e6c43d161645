#!/usr/bin/env bash
# install.sh PYTHON ARGUMENTS...: `pip install ARGUMENTS` for PYTHON, by uv where .venv has it: a fifth of the time. uv is given
# the index, the folders of wheels and the certificates that pip is set to. Where uv fails, it says why, and pip does it.
set -euo pipefail
python=$1
shift
uv=$(dirname "$0")/../.venv/bin/uv

setting() { printf '%b' "$("$python" -m pip config list | sed -n "s/^[^=]*\.$1='\(.*\)'\$/\1/p" | tail -1)"; }

by_uv() {
  local options=(--quiet --index-strategy unsafe-best-match) name value certificates
  for name in index-url extra-index-url find-links; do
    for value in $(setting $name); do options+=("--$name" "$value"); done
  done
  certificates=$(setting cert)
  [ -z "$certificates" ] || export SSL_CERT_FILE=$certificates
  "$uv" pip install --python "$python" "${options[@]}" "$@"
}

if [ -x "$uv" ] && by_uv "$@"; then exit 0; fi
"$python" -m pip install --disable-pip-version-check --no-compile "$@"
