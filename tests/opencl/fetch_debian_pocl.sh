#!/usr/bin/env bash
# Unpacks Debian's PoCL, and what it needs that is not installed, into a directory: nothing is installed, no root needed.
# Without apt, or without Debian's registry at hand, it says so and succeeds: the tests on that PoCL are then skipped.
set -euo pipefail
target=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

without() {
    echo "No Debian PoCL ($1): its tests are skipped. With apt and Debian's registry at hand, run make test again."
    exit 0
}

command -v apt-get >/dev/null && command -v dpkg-deb >/dev/null || without "there is no apt-get"
mkdir -p "$work/lists/partial" "$work/archives/partial" "$work/root"
options=(
    -qq -y --no-install-recommends --download-only
    -o "Dir::State::lists=$work/lists" -o "Dir::Cache=$work" -o "Dir::Cache::archives=$work/archives"
    -o Debug::NoLocking=1 -o APT::Sandbox::User="$(id -un)" -o Acquire::Languages=none
    -o Acquire::http::Timeout=20 -o Acquire::https::Timeout=20 -o Acquire::Retries=1
)
apt-get "${options[@]}" update >"$work/log" 2>&1 || without "apt-get update: $(tail -n 1 "$work/log")"
apt-get "${options[@]}" install pocl-opencl-icd >"$work/log" 2>&1 || without "apt-get: $(tail -n 1 "$work/log")"
for package in "$work"/archives/*.deb; do
    [ -e "$package" ] || without "pocl-opencl-icd is installed already, and a device like any other"
    dpkg-deb --extract "$package" "$work/root"
done
rm -rf "$target"
mv "$work/root" "$target"
