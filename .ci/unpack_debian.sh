#!/usr/bin/env bash
# Unpacks packages of Debian, and what they need that is not installed, into a directory: nothing is installed, no root
# needed. Without apt, or without Debian's registry at hand, it says so and fails: what it is for does without.
#   .ci/unpack_debian.sh DIRECTORY PACKAGE...
#   .ci/unpack_debian.sh --alone DIRECTORY PACKAGE...   without what they need, and without those that there are not
set -euo pipefail
alone=
[ "$1" != --alone ] || { alone=yes; shift; }
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
if [ -n "$alone" ]; then
    for package in $packages; do
        (cd "$work/archives" && apt-get "${options[@]}" download "$package") >"$work/log" 2>&1 \
            || echo "Not unpacked: $package ($(tail -n 1 "$work/log"))"
    done
else
    apt-get "${options[@]}" install "$@" >"$work/log" 2>&1 || without "apt-get: $(tail -n 1 "$work/log")"
fi
for package in "$work"/archives/*.deb; do
    [ -e "$package" ] || without "none is there, or all are installed"
    dpkg-deb --extract "$package" "$work/root"
done
rm -rf "$target"
mkdir -p "$(dirname "$target")"
mv "$work/root" "$target"
