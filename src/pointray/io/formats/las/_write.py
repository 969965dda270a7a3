"""Writer for LAS 1.4 and LAZ."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ....base.progress import Progress, report_progress
from ....cloud.points import Points
from .._losses import Losses
from .._source import CHUNK
from ._plan import Plan, plan_of, record_of


def write(file: Any, points: Points, progress: Progress | None = None) -> Losses:
    """Write all data of the points to a stream as LAS 1.4 or, if its path ends with .laz, LAZ.

    Rows without a finite position are left out. Return descriptions of this and of what LAS cannot store.
    """
    losses: Losses = []
    plan = plan_of(points, losses)
    with recording_errors(file) as stream:
        _write_rows(stream, points, plan, progress)
    return losses


def _write_rows(stream: Any, points: Points, plan: Plan, progress: Progress | None) -> None:
    import laspy

    packed = Path(stream.path).suffix.lower() == ".laz"
    backend = laspy.LazBackend.LazrsParallel if packed else None
    whole = bool(plan.finite.all())
    with laspy.LasWriter(stream, plan.header, do_compress=packed, laz_backend=backend, closefd=False) as writer:
        for start in range(0, len(points), CHUNK):
            part = slice(start, start + CHUNK)
            record = record_of(points, plan, part)
            writer.write_points(record if whole else record[plan.finite[part]])
            report_progress(progress, min(part.stop / len(points), 1.0))
        if plan.trailing:
            writer.write_evlrs(laspy.vlrs.vlrlist.VLRList(plan.trailing))


@contextmanager
def recording_errors(file: Any) -> Iterator[Any]:
    """Yield the output stream for lazrs, which hides exceptions of streams: the first one is raised again at the end.

    Other errors of lazrs, panics of Rust, become ValueErrors.
    """
    stream = _ErrorRecorder(file)
    try:
        yield stream
    except BaseException as error:
        if stream.error is not None:
            raise stream.error from None
        if isinstance(error, Exception | KeyboardInterrupt | SystemExit):
            raise
        raise ValueError(f"lazrs cannot compress the points: {error}") from None  # a Rust panic


class _ErrorRecorder:
    """Output stream that keeps its first exception, which lazrs hides."""

    def __init__(self, file: Any) -> None:
        self._file, self.path = file, file.path
        self.error: BaseException | None = None

    def _do(self, name: str, *arguments: Any) -> Any:
        try:
            return getattr(self._file, name)(*arguments)
        except BaseException as error:
            self.error = self.error or error
            raise

    def write(self, data: Any) -> Any:
        return self._do("write", data)

    def seek(self, offset: int, whence: int = 0) -> Any:
        return self._do("seek", offset, whence)

    def tell(self) -> Any:
        return self._do("tell")

    def flush(self) -> Any:
        return self._do("flush")
