"""A Debian of its own, booted with systemd, cut off from the network but for one cable to an imager.

Needs root, systemd-container and mmdebstrap. The machine's tree is a folder; what runs in it is in namespaces and a
control group of its own, so that a power cut is one write.
"""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

PACKAGES = (
    "systemd-sysv,dbus,udev,systemd-timesyncd,python3,python3-gi,gir1.2-aravis-0.8,libgomp1,procps,iproute2,sqlite3"
)
IMAGER_ADDRESS = "192.168.77.2"
HOST_ADDRESS = "192.168.77.1"

_ENDS_WITHIN_S = 120.0  # beside a heavy load; at once on an idle host
_ENVIRONMENT = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/root", "LANG": "C.UTF-8"}  # none of the host's

# A private mount namespace with cgroup v2 alone, then nspawn without a registration that needs the host's D-Bus.
_BOOT = """
set -eu
name=$1 tree=$2 network=$3; shift 3
umount -R /sys/fs/cgroup
mount -t cgroup2 cgroup2 /sys/fs/cgroup
mkdir -p "/sys/fs/cgroup/$name"
echo $$ > "/sys/fs/cgroup/$name/cgroup.procs"
export SYSTEMD_NSPAWN_UNIFIED_HIERARCHY=1
exec systemd-nspawn -q -D "$tree" --boot --network-namespace-path="/run/netns/$network" --register=no --keep-unit \
    --system-call-filter=bpf --hostname="$name" "$@"
"""


def build_tree(tree: Path, packages: str = PACKAGES) -> None:
    """Unpack a small Debian with packages, else what sunarc's depends on; the mirror is the one that this host uses."""
    sources = "/etc/apt/sources.list.d/debian.sources"
    command = ["mmdebstrap", "--quiet", "--variant=minbase", "--format=directory", f"--include={packages}"]
    subprocess.run([*command, "bookworm", tree, sources], check=True)


@contextmanager
def cabled(name: str) -> Iterator[tuple[str, str]]:
    """Make two network namespaces, the field computer's and the imager's, with one cable between them."""
    field_net, imager_net = f"{name}-field", f"{name}-imager"
    for network in (field_net, imager_net):
        run("ip", "netns", "add", network)
        run("ip", "-n", network, "link", "set", "lo", "up")
    try:
        run("ip", "-n", field_net, "link", "add", "camera0", "mtu", "9000", "type", "veth", "peer", "host0")
        run("ip", "-n", field_net, "link", "set", "host0", "netns", imager_net)
        for network, device, address in (
            (field_net, "camera0", HOST_ADDRESS),
            (imager_net, "host0", IMAGER_ADDRESS),
        ):
            run("ip", "-n", network, "address", "add", f"{address}/24", "dev", device)
            run("ip", "-n", network, "link", "set", device, "mtu", "9000", "up")
        yield field_net, imager_net
    finally:
        for network in (field_net, imager_net):
            run("ip", "netns", "delete", network)


def run(*command: str | Path, timeout_s: float = 60.0) -> str:
    """Run a command of the host and return what it prints; a failure is the test's."""
    answer = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout_s)
    assert answer.returncode == 0, f"{shlex.join(map(str, command))}: {answer.stdout}{answer.stderr}"
    return answer.stdout


@dataclass(slots=True)
class Machine:
    """A tree that can be booted, driven, stopped and cut.

    Attributes
    ----------
    name : of the machine and its control group.
    tree : its root folder; what it writes stays there.
    network : the namespace it lives in.
    options : further ones of systemd-nspawn.
    """

    name: str
    tree: Path
    network: str
    options: tuple[str, ...] = ()
    _nspawn: subprocess.Popen[bytes] | None = field(default=None, init=False)
    _leader: str = field(default="", init=False)

    def boot(self, *, within_s: float = 180.0) -> float:
        """Switch on and wait until systemd has come up; return the seconds that took."""
        begun = time.monotonic()
        command = ["unshare", "--mount", "--propagation", "private", "bash", "-c", _BOOT, "bash"]
        with (self.tree.parent / f"{self.name}.console").open("ab") as console:
            self._nspawn = subprocess.Popen(
                [*command, self.name, str(self.tree), self.network, *self.options],
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._leader = ""
        wait_for(self._is_up, within_s=within_s, what="the machine to boot")
        return time.monotonic() - begun

    def call(self, *command: str, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
        """Run a command in the machine and return how it went."""
        entered = ["nsenter", "-t", self._leader, "-m", "-u", "-i", "-n", "-p", "-C", "--", *command]
        return subprocess.run(entered, env=_ENVIRONMENT, capture_output=True, text=True, check=False, timeout=timeout_s)

    def __call__(self, *command: str, timeout_s: float = 120.0) -> str:
        """Run a command in the machine and return what it prints; a failure is the test's."""
        answer = self.call(*command, timeout_s=timeout_s)
        assert answer.returncode == 0, f"{shlex.join(command)}: {answer.stdout}{answer.stderr}"
        return answer.stdout

    def stop(self) -> None:
        """Shut down in an orderly way."""
        if self._nspawn is None:
            return
        self._nspawn.send_signal(signal.SIGTERM)
        try:
            self._nspawn.wait(30.0)
        except subprocess.TimeoutExpired:
            self.cut()
        self._nspawn = None
        self._sweep()

    def cut(self) -> None:
        """Take the power away: every process ends at once, none is told."""
        (control_groups() / self.name / "cgroup.kill").write_text("1")
        if self._nspawn is not None:
            self._nspawn.wait(_ENDS_WITHIN_S)
        self._nspawn = None
        self._sweep()

    def _is_up(self) -> bool:
        assert self._nspawn is not None
        assert self._nspawn.poll() is None, "nspawn ended; see the console beside the tree"
        children = subprocess.run(
            ["pgrep", "-P", str(self._nspawn.pid)], capture_output=True, text=True, check=False
        ).stdout.split()
        if not children:
            return False
        self._leader = children[0]  # read anew: the first child does not live long
        return self.call("systemctl", "is-system-running").stdout.strip() in {"running", "degraded"}

    def _sweep(self) -> None:
        wait_for(self._swept, within_s=_ENDS_WITHIN_S, what="the control groups to empty")

    def _swept(self) -> bool:
        top = control_groups() / self.name
        for folder, _, _ in os.walk(top, topdown=False):
            try:
                Path(folder).rmdir()
            except OSError:
                return False
        return not top.exists()


def control_groups() -> Path:
    """Return where this host mounts cgroup v2."""
    return Path(run("findmnt", "-n", "-t", "cgroup2", "-o", "TARGET").split()[0])


def wait_for(asked: Callable[[], bool], *, within_s: float, what: str, every_s: float = 0.1) -> float:
    """Ask until the answer is yes; return the seconds that took."""
    begun = time.monotonic()
    while not asked():
        assert time.monotonic() - begun < within_s, f"waited {within_s:g} s for {what}"
        time.sleep(every_s)
    return time.monotonic() - begun


def copy_tree(source: Path, target: Path) -> Path:
    """Copy a machine's tree with owners and devices; return the copy."""
    if target.exists():
        shutil.rmtree(target)
    run("cp", "-a", "--reflink=auto", source, target, timeout_s=600.0)
    return target
