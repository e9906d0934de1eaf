#!/bin/sh
# Builds the images as the tests need them: on Debian 12 as root, from a base image that is made of Debian's packages, since
# no registry of images need be reachable. What pip is told on this machine, it is told in the builds too.
set -eu
cd "$(dirname "$0")/../.."
base=localhost/revnm-base:bookworm
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

if ! podman image exists $base; then
    # As Debian's slim images: without manuals and translations, with licences.
    mmdebstrap --quiet --variant=minbase --dpkgopt='path-exclude=/usr/share/man/*' --dpkgopt='path-exclude=/usr/share/locale/*' \
        --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-include=/usr/share/doc/*/copyright' \
        bookworm "$work/base.tar" "$(for list in /etc/apt/sources.list /etc/apt/sources.list.d/debian.sources; do [ ! -s $list ] || echo $list; done | tail -1)"
    podman import --quiet "$work/base.tar" $base
fi

mkdir "$work/pip"
cp -L /etc/ssl/certs/ca-certificates.crt "$work/pip/ca.crt"
{ echo "[global]"; echo "cert = /etc/xdg/pip/ca.crt"; pip config list | sed -n "s/^global\.\(index-url\|trusted-host\|proxy\)='\(.*\)'/\1 = \2/p"; } > "$work/pip/pip.conf"

build() { # IMAGE FILE TARGET
    podman build --quiet --isolation chroot --format docker --volume "$work/pip:/etc/xdg/pip:ro" --build-arg BASE=$base \
        --build-arg REVISION="$(git rev-parse HEAD)" --file "docker/$2" --target "$3" --tag "localhost/$1" .
}
build revnm-robot robot.Dockerfile robot
build revnm-server server.Dockerfile server
build revnm-simulator server.Dockerfile simulator
