"""Rigs without a cable: patterns go out as pictures, and brackets come back as pictures."""

from rfpipe.rigs.offline.brackets import Checked, check_pictures
from rfpipe.rigs.offline.rig import Brackets, OfflineRig, offline_rig
from rfpipe.rigs.offline.sheet import Sheet, Shown, read_sheet, write_sheet

__all__ = [
    "Brackets",
    "Checked",
    "OfflineRig",
    "Sheet",
    "Shown",
    "check_pictures",
    "offline_rig",
    "read_sheet",
    "write_sheet",
]
