#!/usr/bin/env bash
# Try the README's promise: a Debian with nothing but python3, python3-venv and make runs
# `make demo` and `make test` in a fresh copy of this checkout. Builds a root in DIRECTORY with
# debootstrap (as root; some minutes, 2 GB with the virtual environment). Not part of CI.
#
# Usage: tests/bare_root.sh [DIRECTORY [TARGET...]]       default: /tmp/vhp-bare demo test
# SUITE=bookworm and PYTHON=python3 choose the Debian release and the interpreter's package.
# The pip settings of the environment (PIP_*) and the CA certificates are handed on.
set -euo pipefail

checkout=$(cd "$(dirname "$0")/.." && pwd)
root=${1:-/tmp/vhp-bare}
shift || true
targets=("${@:-demo}")
[ $# -gt 0 ] || targets=(demo test)
suite=${SUITE:-bookworm}
python=${PYTHON:-python3}

if [ ! -x "$root/usr/bin/make" ]; then
    debootstrap --variant=minbase --include="$python,$python-venv,make,ca-certificates" "$suite" "$root" >/dev/null
fi
mkdir -p "$root/usr/local/share" "$root/home/vhp"
cp /etc/resolv.conf "$root/etc/resolv.conf"
cp -L /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/ca-certificates.crt"

rm -rf "$root/home/vhp/checkout"
mkdir "$root/home/vhp/checkout"
# What a clone would hold: tracked files and new ones that aren't ignored, as they are now.
(cd "$checkout" && git ls-files -z --cached --others --exclude-standard | while IFS= read -r -d '' name; do
    [ ! -e "$name" ] || printf '%s\0' "$name"
done | tar --null -T - -c) | tar -x -C "$root/home/vhp/checkout"
if [ -d "$checkout/../shared/data" ]; then
    mkdir -p "$root/home/vhp/shared"
    cp -rn "$checkout/../shared/data" "$root/home/vhp/shared/" || true
fi

mountpoint -q "$root/proc" || mount --bind /proc "$root/proc"
trap 'umount "$root/proc"' EXIT

handed_on=(HOME=/root PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 TERM=dumb)
while IFS= read -r setting; do handed_on+=("$setting"); done < <(env | grep -E '^PIP_(INDEX_URL|EXTRA_INDEX_URL|CERT|DEFAULT_TIMEOUT|TRUSTED_HOST|PROXY)=' || true)

echo "tools in the bare root: $(chroot "$root" sh -c 'for t in cc gcc clang git python3 make; do command -v $t; done' | tr '\n' ' ')"
for target in "${targets[@]}"; do
    echo "== make $target"
    chroot "$root" env -i "${handed_on[@]}" PYTHON="$python" bash -c "cd /home/vhp/checkout && time make $target PYTHON=$python"
done
