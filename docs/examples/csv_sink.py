"""`j2a bridge URL --sink csv:drive.csv`, a sink of another package: a line for each reading."""

import csv
from pathlib import Path
from typing import TextIO

from j2a_bridge import Sink, Topic, Update


class CsvSink(Sink):
    """Writes samples as text for spreadsheets."""

    SUMMARY = "readings as lines of a CSV file"
    ARGUMENT = "FILE.csv"
    _file: TextIO | None = None

    def open(self) -> None:
        """Begin the file, or go on with it after a failure."""
        self._file = Path(self.argument).open("a", newline="", encoding="utf-8")  # noqa: SIM115
        self._lines = csv.writer(self._file)

    def announce(self, topic: Topic) -> None:
        """Do nothing: each line names its topic."""

    def retract(self, topic: Topic) -> None:
        """Do nothing."""

    def publish(self, update: Update) -> None:
        """Write topic, time in ns since 1970, channel and value; N/A is an empty field."""
        for reading, stamp_ns in zip(update.sample.readings, update.stamps_ns, strict=True):
            self._lines.writerow([update.topic.name, stamp_ns, reading.channel, reading.value])

    def flush(self) -> None:
        """Let others read what was written, as no further sample waits."""
        if self._file is not None:
            self._file.flush()

    def close(self) -> None:
        """End the file, if there is one."""
        if self._file is not None:
            self._file.close()
