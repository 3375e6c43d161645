#!/usr/bin/env bash
# install.sh PYTHON ARGUMENTS...: `pip install ARGUMENTS` for PYTHON, which needs no pip, by .venv's uv where it is there: a
# fifth of the time. uv is given the index, folders of wheels and certificates that pip is set to; where it fails, pip does it.
set -euo pipefail
python=$1
shift
bin=$(dirname "$0")/../.venv/bin

setting() { printf '%b' "$(sed -n "s/^[^=]*\.$1='\(.*\)'\$/\1/p" <<<"$settings" | tail -1)"; }

by_uv() {
  local options=(--quiet --index-strategy unsafe-best-match) name value certificates settings
  settings=$("$bin/python" -m pip config list)
  for name in index-url extra-index-url find-links; do
    for value in $(setting $name); do options+=("--$name" "$value"); done
  done
  certificates=$(setting cert)
  [ -z "$certificates" ] || export SSL_CERT_FILE=$certificates
  "$bin/uv" pip install --python "$python" "${options[@]}" "$@"
}

if [ -x "$bin/uv" ] && by_uv "$@"; then exit 0; fi
"$bin/python" -m pip --python "$python" install --disable-pip-version-check --no-compile "$@"
