"""The public contract suites: what methods, scenes, rigs and devices must do; the dot test.

In a test file of your own, for pytest::

    from rfpipe.testing import CameraContract

    class TestMyCamera(CameraContract):
        def make_camera(self):
            return MyCamera(...)

`rfpipe.testing.faults` has devices with known faults, to test a calibration's or a driver's checks.
"""

from rfpipe.testing import faults
from rfpipe.testing.checks import dot_test
from rfpipe.testing.devices import CameraContract, ProjectorContract
from rfpipe.testing.methods import MethodContract
from rfpipe.testing.rigs import RigContract
from rfpipe.testing.scenes import SceneContract

__all__ = [
    "CameraContract",
    "MethodContract",
    "ProjectorContract",
    "RigContract",
    "SceneContract",
    "dot_test",
    "faults",
]
