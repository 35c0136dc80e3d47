#!/bin/sh
# Brings the programs that some tests need beside Python, Chromium and node, with apt-get where there is one.
set -eu

has() {
  for program in "$@"; do
    if command -v "$program" > /dev/null; then return 0; fi
  done
  return 1
}

missing() {
  has chromium chromium-browser google-chrome || printf 'chromium '
  { has node && has npm; } || printf 'nodejs npm '
}

if [ -n "$(missing)" ] && has apt-get; then
  if [ "$(id -u)" = 0 ]; then root=; else root=sudo; fi
  $root apt-get update -qq || true
  for package in $(missing); do
    $root env DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "$package" || true
  done
fi
if [ -n "$(missing)" ]; then
  echo "still missing: $(missing); install them as this system does, so that they are found by these names" >&2
  exit 1
fi
