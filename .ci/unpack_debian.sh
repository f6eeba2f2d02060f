#!/usr/bin/env bash
# Unpacks packages of Debian, and what they need that is not installed, into a directory: nothing is installed, no root
# needed. Without apt, or without Debian's registry at hand, it says so and fails: what it is for does without.
#   .ci/unpack_debian.sh DIRECTORY PACKAGE...
set -euo pipefail
target=$1
shift
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

without() {
    echo "Not unpacked: $packages ($1)"
    exit 1
}

packages="$*"
command -v apt-get >/dev/null && command -v dpkg-deb >/dev/null || without "there is no apt-get"
mkdir -p "$work/lists/partial" "$work/archives/partial" "$work/root"
options=(
    -qq -y --no-install-recommends --download-only
    -o "Dir::State::lists=$work/lists" -o "Dir::Cache=$work" -o "Dir::Cache::archives=$work/archives"
    -o Debug::NoLocking=1 -o APT::Sandbox::User="$(id -un)" -o Acquire::Languages=none
    -o Acquire::http::Timeout=20 -o Acquire::https::Timeout=20 -o Acquire::Retries=1
)
apt-get "${options[@]}" update >"$work/log" 2>&1 || without "apt-get update: $(tail -n 1 "$work/log")"
apt-get "${options[@]}" install "$@" >"$work/log" 2>&1 || without "apt-get: $(tail -n 1 "$work/log")"
for package in "$work"/archives/*.deb; do
    [ -e "$package" ] || without "installed already"
    dpkg-deb --extract "$package" "$work/root"
done
rm -rf "$target"
mv "$work/root" "$target"
