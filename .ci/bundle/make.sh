#!/bin/sh
# Makes dist/hilcell-VERSION-PYTHON-PLATFORM.tar.gz: all that a PC without a network needs.
# Called by `make bundle`, with the python whose wheels it gathers.
set -eu
cd "$(dirname "$0")/../.."
python=$1
version=$("$python" -c 'from importlib.metadata import version; print(version("hilcell"))')
made_for=$("$python" -c 'import sys, sysconfig; v = sys.version_info
print("python%d.%d" % v[:2], sysconfig.get_platform())')
name=hilcell-$version-$(echo "$made_for" | tr ' ' '-')
folder=dist/$name
rm -rf "$folder"
mkdir -p "$folder/wheels"
"$python" -m pip download --quiet --disable-pip-version-check --only-binary :all: \
    --require-hashes -r requirements-run.lock --dest "$folder/wheels"
"$python" -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation \
    --wheel-dir "$folder/wheels" .
cp -R .ci/bundle/install.sh requirements-run.lock LICENSE README.md CHANGELOG.md docs "$folder"
echo "$version $made_for" > "$folder/made-for"
(cd "$folder" && find . -type f ! -name SHA256SUMS -exec sha256sum {} + | sort -k 2 > SHA256SUMS)
tar -C dist -czf "$folder.tar.gz" "$name"
rm -rf "$folder"
echo "$folder.tar.gz"
