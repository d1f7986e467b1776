"""How the system starts the daemon: a rule of udev, a wrapper and a unit of systemd.

In: the program `j2a`. Out: texts of files. Rules: where systemd runs, udev asks it for the unit;
elsewhere udev starts the wrapper, which may be edited, as in the thesis (listings 6.1 and 6.2).
"""

import stat
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

__all__ = ["SystemFile", "closed_part", "system_files"]

RULE_PLACE: Final = Path("/etc/udev/rules.d/71-j2a-syncd.rules")
WRAPPER_PLACE: Final = Path("/etc/j2a/syncd-udev.sh")
UNIT_PLACE: Final = Path("/etc/systemd/system/j2a-syncd.service")

_RULE: Final = """\
# Boards with the interface SyncUSB (ff/34/01): j2a syncd gives them the time of this computer.
ACTION!="add", GOTO="j2a_syncd_end"
SUBSYSTEM!="usb", GOTO="j2a_syncd_end"
ENV{{DEVTYPE}}!="usb_interface", GOTO="j2a_syncd_end"
ATTR{{bInterfaceClass}}!="ff", GOTO="j2a_syncd_end"
ATTR{{bInterfaceSubClass}}!="34", GOTO="j2a_syncd_end"
ATTR{{bInterfaceProtocol}}!="01", GOTO="j2a_syncd_end"
ATTR{{interface}}!="SyncUSB", GOTO="j2a_syncd_end"
TEST=="/run/systemd/system", TAG+="systemd", ENV{{SYSTEMD_WANTS}}+="j2a-syncd.service"
TEST!="/run/systemd/system", RUN+="{wrapper}"
LABEL="j2a_syncd_end"
"""

_WRAPPER: Final = """\
#!/bin/sh
# udev runs this where there is no systemd, once for each board with SyncUSB; options may be added.
# The first one stays as the daemon, each later one tells that one to look for boards.
exec {program} syncd --daemon --interval 1
"""

_UNIT: Final = """\
[Unit]
Description=One clock for all J2A boards
After=systemd-udevd.service

[Service]
Type=exec
ExecStart={program} syncd
Restart=on-failure
RuntimeDirectory=j2a
RuntimeDirectoryMode=0755
DynamicUser=yes
SupplementaryGroups={group}
DevicePolicy=closed
DeviceAllow=char-usb_device rw
NoNewPrivileges=yes
CapabilityBoundingSet=
ProtectSystem=strict
ProtectHome=read-only
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectProc=invisible
PrivateTmp=yes
RestrictAddressFamilies=AF_UNIX AF_NETLINK
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
LockPersonality=yes
SystemCallArchitectures=native
SystemCallFilter=@system-service
UMask=0077

[Install]
WantedBy=multi-user.target
"""


@dataclass(frozen=True, slots=True)
class SystemFile:
    """A file of the system.

    Attributes:
        place: where it belongs.
        text: what it holds.
        mode: its permissions.
    """

    place: Path
    text: str
    mode: int = 0o644


def system_files(program: str, group: str) -> list[SystemFile]:
    """Return the files that let the system start the daemon.

    Args:
        program: the path of `j2a`, without a space or a quote.
        group: of those who may use USB boards.
    """
    return [
        SystemFile(RULE_PLACE, _RULE.format(wrapper=WRAPPER_PLACE)),
        SystemFile(WRAPPER_PLACE, _WRAPPER.format(program=program), 0o755),
        SystemFile(UNIT_PLACE, _UNIT.format(program=program, group=group)),
    ]


def closed_part(paths: Iterable[Path]) -> Path | None:
    """Return what keeps other users, such as that of the unit, from reaching files, or None.

    Args:
        paths: of files and folders; links count, and so does what they lead to.
    """
    for path in paths:
        for target in (path.absolute(), path.resolve()):
            for part in (*reversed(target.parents), target):
                needed = stat.S_IXOTH if part.is_dir() else stat.S_IROTH
                if not part.is_symlink() and not part.stat().st_mode & needed:
                    return part
    return None
