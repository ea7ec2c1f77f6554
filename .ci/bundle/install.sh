#!/bin/sh
# Installs hilcell from this folder without a network:  sh install.sh [PREFIX]
# PREFIX (default: ~/.local) gets lib/hilcell-VERSION and bin/hilcell. PYTHON names another python.
set -eu
prefix=${1:-"$HOME/.local"}
case $prefix in
/*) ;;
*) prefix=$PWD/$prefix ;;
esac
cd "$(dirname "$0")"
python=${PYTHON:-python3}
read -r version made_for < made-for

refuse() {
    echo "install.sh: $1" >&2
    exit 2
}

found=$("$python" -c 'import sys, sysconfig; v = sys.version_info
print("python%d.%d" % v[:2], sysconfig.get_platform())' 2>/dev/null) ||
    refuse "$python does not run, expected ${made_for%% *}; install it, or name it: PYTHON=/path/to/python3 sh install.sh"
[ "$found" = "$made_for" ] ||
    refuse "this archive is for $made_for, found $found; name a fitting one: PYTHON=/path/to/python3 sh install.sh, or make the archive with that python: make bundle PYTHON=.."
sha256sum --check --quiet SHA256SUMS ||
    refuse "files of the archive are damaged or missing; copy and unpack it again"

home=$prefix/lib/hilcell-$version
mkdir -p "$prefix/bin"
"$python" -m venv --clear --without-pip "$home"
pip() {
    "$home/bin/python" "$(echo wheels/pip-*.whl)/pip" --disable-pip-version-check --isolated \
        install --quiet --no-index --find-links wheels "$@"
}
pip --require-hashes -r requirements-run.lock
pip --no-deps wheels/hilcell-*.whl
ln -sf "$home/bin/hilcell" "$prefix/bin/hilcell"
echo "installed: $prefix/bin/hilcell, version $version; \`hilcell doctor\` checks this PC"
case ":$PATH:" in
*":$prefix/bin:"*) ;;
*) echo "to call it as \`hilcell\`, add $prefix/bin to PATH" ;;
esac
