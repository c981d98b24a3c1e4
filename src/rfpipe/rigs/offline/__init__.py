"""Rigs without a cable: patterns go out as pictures, and brackets come back as pictures."""

from rfpipe.rigs.offline.brackets import Checked, check_pictures
from rfpipe.rigs.offline.rig import OfflineRig, offline_rig
from rfpipe.rigs.offline.sheet import Sheet, read_sheet

__all__ = ["Checked", "OfflineRig", "Sheet", "check_pictures", "offline_rig", "read_sheet"]
