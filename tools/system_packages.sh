#!/usr/bin/env bash
# Shared libraries that the Python wheels load but do not carry (OpenGL, USB) and a software renderer for MuJoCo; git is asked by rsl_rl.
# Installs what is missing where it may (Debian or Ubuntu, as root); elsewhere it says what to install.
set -euo pipefail

# Gazebo's own parser (libsdformat) checks an export in the tests, where the release has it.
packages=(libgl1 libegl1 libopengl0 libusb-1.0-0 libosmesa6 libgomp1 git libsdformat12-12)

command -v dpkg-query >/dev/null || {
  echo "not a Debian system: the equivalents of ${packages[*]} must be there" >&2
  exit 0
}
missing=()
for package in "${packages[@]}"; do
  [ "$(dpkg-query -W -f='${Status}' "$package" 2>/dev/null)" = "install ok installed" ] || missing+=("$package")
done
[ ${#missing[@]} -eq 0 ] && exit 0
if [ "$(id -u)" -ne 0 ]; then
  echo "missing system packages, please run: sudo apt-get install ${missing[*]}" >&2
  exit 0
fi
apt-get update -qq
known=()
for package in "${missing[@]}"; do
  if apt-cache show "$package" >/dev/null 2>&1; then known+=("$package"); else echo "no package $package here: going on without" >&2; fi
done
[ ${#known[@]} -eq 0 ] && exit 0
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${known[@]}"
