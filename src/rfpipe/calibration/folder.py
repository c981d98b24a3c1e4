"""Files of a calibration."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from rfpipe.calibration.steps import STEPS
from rfpipe.calibration.verdicts import Findings, Verdict
from rfpipe.errors import StoreError
from rfpipe.rigs.calibrated import read_manifest_and_arrays
from rfpipe.rigs.settings import Flat, differences
from rfpipe.store import read_manifest, write_arrays, write_manifest


@dataclass(frozen=True)
class StepConditions:
    """Conditions of a step's measurement; the step is measured again when one of them changes.

    Attributes
    ----------
    settings : dict
        Settings in the rig's file that affect the step, by dotted name.
    devices : dict
        Descriptions of projector, camera and sensor, by dotted name.
    needs : dict
        Fingerprints of the steps whose findings this one uses.
    """

    settings: Flat
    devices: Flat
    needs: dict[str, str]

    def changes_since(self, previous: StepConditions) -> list[str]:
        """Describe each changed setting or, if none changed, each change of the devices."""
        return differences(previous.settings, self.settings) or differences(
            previous.devices, self.devices
        )


@dataclass(frozen=True)
class CalibrationFolder:
    """Folder of a calibration: a manifest and arrays for each step, and the result.

    Attributes
    ----------
    path : Path
    """

    path: Path

    def manifest(self, step: str) -> Path:
        """Path of a step's manifest."""
        return self.path / "steps" / f"{step}.json"

    def store(self, step: str) -> Path:
        """Path of a step's arrays."""
        return self.path / "steps" / f"{step}.zarr"

    def is_done(self, step: str) -> bool:
        """Test whether a step is complete."""
        return self.manifest(step).is_file()

    def written_at(self) -> dict[str, int]:
        """Modification times of the manifests of complete steps, in ns, by step."""
        return {
            name: self.manifest(name).stat().st_mtime_ns for name in STEPS if self.is_done(name)
        }

    def read(self, step: str) -> Findings:
        """Read the findings of a step.

        Raises
        ------
        StoreError
            When the step isn't complete.
        IntegrityError
            When its files are damaged.
        """
        if not self.is_done(step):
            raise StoreError(
                f"{self.manifest(step)}: the step {step} isn't complete",
                remedy="run `rfpipe calibrate`, which measures it",
            )
        manifest, arrays = read_manifest_and_arrays(self.manifest(step), self.store(step))
        verdict = Verdict(manifest["standing"], manifest["verdict"])
        return Findings(verdict, manifest["facts"], arrays)

    def verdicts(self) -> dict[str, dict[str, str]]:
        """Title, standing and verdict of each complete step."""
        done = {name: read_manifest(self.manifest(name)) for name in STEPS if self.is_done(name)}
        return {
            name: {
                "title": STEPS[name].title,
                "standing": str(manifest["standing"]),
                "verdict": str(manifest["verdict"]),
            }
            for name, manifest in done.items()
        }

    def conditions(self, step: str) -> StepConditions | None:
        """Conditions of a step's measurement, None where it isn't complete."""
        if not self.is_done(step):
            return None
        manifest = read_manifest(self.manifest(step))
        return StepConditions(manifest["settings"], manifest["devices"], manifest["needs"])

    def write(self, step: str, findings: Findings, conditions: StepConditions) -> None:
        """Write the findings of a step; its manifest last, which marks the step as complete."""
        self.path.joinpath("steps").mkdir(parents=True, exist_ok=True)
        self.manifest(step).unlink(missing_ok=True)
        standing, text = findings.verdict
        digest = write_arrays(self.store(step), findings.arrays, {})
        manifest = {
            "step": step,
            **asdict(conditions),
            "standing": standing,
            "verdict": text,
            "facts": findings.facts,
            "arrays": digest,
        }
        write_manifest(self.manifest(step), manifest)
