#!/usr/bin/env bash
# Builds a wheel, looks whether it has every file of the packages, and runs it where the source folder is out of reach: the
# diagnosis in an environment that holds nothing but the core, other examples with the packages of .venv.
#   bash tools/check_wheel.sh
set -euo pipefail
cd "$(dirname "$0")/.."
source=$PWD
python=$source/.venv/bin/python
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
unset PYTHONPATH

mkdir "$work/source"
cp -r pyproject.toml README.md LICENSE realsim trainer "$work/source" # setuptools writes where it builds
"$python" -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir "$work" "$work/source"
wheel=$(echo "$work"/realsim-*.whl)
[ "$(stat -c %s "$wheel")" -le $((40 * 2**20)) ] || { echo "the wheel is larger than 40 MB" >&2; exit 1; }
"$python" -m zipfile -e "$wheel" "$work/wheel"
cp -r examples "$work/examples"
cd "$work"
for package in realsim trainer; do diff --recursive --exclude=__pycache__ "$source/$package" "wheel/$package"; done

# What the messages tell people to type, from an index that has the wheel alone.
"$python" -m pip install --quiet --disable-pip-version-check --dry-run --ignore-installed --no-deps --no-index \
  --find-links "$work" "realsim[recon]"
"$python" -m venv --without-pip "$work/core"
bash "$source/tools/install.sh" "$work/core/bin/python" --quiet --constraint "$source/constraints.txt" "$wheel"
"$work/core/bin/python" -c 'import realsim; assert "site-packages" in realsim.__file__, realsim.__file__'
"$work/core/bin/realsim" --help >/dev/null
"$work/core/bin/python" examples/03_diagnose.py
code=0
"$work/core/bin/realsim" reconstruct nowhere 2>message.txt || code=$?
[ $code -eq 2 ]
grep -q 'pip install "realsim\[recon\]"' message.txt

# The wheel before whatever .venv has of realsim.
export PYTHONPATH=$work/wheel
"$python" -c "import realsim, trainer; assert not realsim.__file__.startswith('$source/realsim'), realsim.__file__"
"$python" examples/02_contact.py
"$python" examples/04_finetune.py
echo "the wheel works: $(basename "$wheel")"
