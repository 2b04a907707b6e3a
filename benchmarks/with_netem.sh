#!/usr/bin/env bash
# Runs a command as root under a Linux kernel with netem, for machines whose kernel lacks it. That kernel is User-Mode
# Linux, an ordinary process that needs no privileges, no image and no virtualisation.
#
#     apt-get install user-mode-linux kmod iproute2        # Debian
#     benchmarks/with_netem.sh [-w FOLDER] [-t SECONDS] [-m MEMORY] COMMAND...
#
# The command reads the files of this machine. Its output is kept in memory and discarded, except for files in FOLDER.
# It has one processor and no network except the namespaces, veth pairs and loopback that it creates. The script exits
# with its status and ends it after SECONDS (600).
set -euo pipefail

usage() { echo "usage: $0 [-w FOLDER] [-t SECONDS] [-m MEMORY] COMMAND..." >&2; exit 2; }
folder="" seconds=600 memory=3G
while getopts "w:t:m:" option; do
    case "$option" in
        w) folder=$(realpath "$OPTARG") ;;
        t) seconds=$OPTARG ;;
        m) memory=$OPTARG ;;
        *) usage ;;
    esac
done
shift $((OPTIND - 1))
[ $# -gt 0 ] || usage
kernel=$(command -v linux.uml || command -v linux) || { echo "$0: user-mode-linux is not installed" >&2; exit 2; }

mine=$(mktemp -d)
trap 'rm -rf "$mine"' EXIT
quoted() { printf ' %q' "$@"; }

# Socket buffers have the limits of this machine.
cp /proc/sys/net/core/{rmem_max,wmem_max} "$mine"
# The first process: an overlay in memory over this machine's files, a few mounts, the modules, then the command in it.
cat >"$mine/init" <<END
#!/bin/bash
export PATH=$(quoted "$PATH:/usr/sbin:/sbin" | cut -c2-) TERM=dumb LANG=C.UTF-8 HOME=$(quoted "$HOME" | cut -c2-)
mount -t proc proc /proc
cd /usr/lib/uml/modules/\$(uname -r)/kernel
for module in fs/overlayfs/overlay net/sched/sch_netem drivers/net/veth; do insmod \$module.ko; done
mount -t tmpfs -o size=90% memory /run
mkdir /run/files /run/work /run/root
mount -t overlay overlay -o lowerdir=/,upperdir=/run/files,workdir=/run/work /run/root
cd /run/root
mount -t devtmpfs dev dev
mkdir dev/shm
for place in run dev/shm; do mount -t tmpfs memory \$place; done
mount -t proc proc proc
mount -t sysfs sys sys
for place in$(quoted "$mine" ${folder:+"$folder"}); do mount -t hostfs none ".\$place" -o "\$place"; done
mkdir run/netns
for limit in rmem_max wmem_max; do cat$(quoted "$mine")/\$limit >proc/sys/net/core/\$limit; done
exec chroot . "$mine/inside" >dev/tty1 2>dev/tty2 <dev/null
END
cat >"$mine/inside" <<END
#!/bin/bash
stty -opost <&1
stty -opost <&2
ip link set lo up
cd$(quoted "$PWD")
timeout $seconds$(quoted "$@")
echo \$? >$(quoted "$mine/status")
echo o >/proc/sysrq-trigger
sleep 10
END
chmod +x "$mine/init" "$mine/inside"

# Consoles 1 and 2 are the command's output and errors. Kernel messages go to a file that is shown on failure.
timeout -k 5 $((seconds + 30)) "$kernel" mem="$memory" root=/dev/root rootfstype=hostfs rootflags=/ ro \
    init="$mine/init" uml_dir="$mine" con=null con0=null,fd:4 con1=null,fd:1 con2=null,fd:3 quiet \
    3>&2 2>"$mine/kernel" 4>"$mine/console" </dev/null || true
[ -s "$mine/status" ] || { cat "$mine/kernel" "$mine/console" >&2; exit 1; }
exit "$(cat "$mine/status")"
