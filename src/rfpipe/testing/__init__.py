"""Contract tests of methods, scenes, rigs and devices, and the dot test of operators.

Subclass a contract in your own test file, and run it with pytest::

    from rfpipe.testing import CameraContract

    class TestMyCamera(CameraContract):
        def make_camera(self):
            return MyCamera(...)

`rfpipe.testing.faults` simulates faulty devices, to test the checks of a calibration or a driver.
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
