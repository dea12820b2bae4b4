"""Rerun: one recording for each start of a run, which `rerun FILE.rrd` shows."""

from collections.abc import Mapping
from pathlib import Path

from novags.testbed.loggers import Sink


def sink(folder: Path, name: str) -> Sink:
    """As `LOGGERS` says."""
    import rerun

    folder.mkdir(parents=True, exist_ok=True)
    file = next(path for k in range(10**6) if not (path := folder / f"{name}{f'-{k}' if k else ''}.rrd").exists())
    recording = rerun.RecordingStream("novags", recording_id=file.stem)
    recording.save(str(file))

    def add(step: int, values: Mapping[str, float]) -> None:
        recording.set_time("step", sequence=step)
        for key, value in values.items():
            recording.log(key, rerun.Scalars(value))

    def close() -> None:
        recording.flush()
        recording.disconnect()

    return Sink(add, close)
