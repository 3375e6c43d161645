#!/usr/bin/env bash
# Shared libraries that the Python wheels load but do not carry (OpenGL, USB) and a software renderer for MuJoCo; git is asked by rsl_rl.
# Installs what is missing where it may (Debian or Ubuntu, as root); elsewhere it says what to install.
set -euo pipefail

packages=(libgl1 libegl1 libopengl0 libusb-1.0-0 libosmesa6 libgomp1 git)

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
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}"
