#!/bin/busybox sh
# Process 1 of the vcan guest: the host's files under a layer of our own, two virtual CAN interfaces, one job, and off.
# @LOAD@ is replaced by the modules in the order of their dependencies, @HOST@ and @JOB@ by how the host's files and the job's directory are
# mounted. The host reads the lines that begin with HIL-GUEST.
busybox=/bin/busybox
off() {
    $busybox echo "HIL-GUEST $1"
    $busybox poweroff -f
}
need() { "$@" || off "FAILED: $*"; }

need $busybox mount -t proc proc /proc
need $busybox mount -t sysfs sysfs /sys
need $busybox mount -t devtmpfs dev /dev
$busybox stty -F /dev/console -onlcr
for module in @LOAD@; do
    need $busybox insmod "/modules/$module.ko"
done

need $busybox mount @HOST@ host /host
need $busybox mount -t tmpfs -o size=75% layer /layer
$busybox mkdir /layer/upper /layer/work
need $busybox mount -t overlay -o lowerdir=/host,upperdir=/layer/upper,workdir=/layer/work root /root
for place in proc sys dev; do
    $busybox mkdir -p "/root/$place"
    need $busybox mount -o move "/$place" "/root/$place"
done
$busybox mkdir -p /root/dev/pts /root/dev/shm /root/hil-job
need $busybox mount -t devpts -o mode=620,ptmxmode=666 pts /root/dev/pts
need $busybox mount -t tmpfs shm /root/dev/shm
need $busybox mount @JOB@ job /root/hil-job
$busybox ln -sf /proc/self/fd /root/dev/fd

need $busybox ip link set lo up
for bus in vcan0 vcan1; do
    need $busybox ip link add "$bus" type vcan
    need $busybox ip link set "$bus" up
done

$busybox echo "HIL-GUEST READY"
$busybox chroot /root /bin/sh /hil-job/job.sh </root/dev/null 2>&1
$busybox echo "$?" >/root/hil-job/status
off DONE
