#!/bin/sh
# Runs a command that starts containers with mounts and a network of its own, so that bridges, firewall rules and published
# ports are seen by nobody else and end with it. Needs root.
set -eu
if [ "${APART:-}" != 1 ]; then
    exec env APART=1 CONTAINERS_CONF="$(realpath "$(dirname "$0")")/containers.conf" unshare --mount --net "$0" "$@"
fi
ip link set lo up
# crun wants one kind of control groups, not both.
if [ -d /sys/fs/cgroup/unified ]; then umount /sys/fs/cgroup/unified; fi
exec "$@"
