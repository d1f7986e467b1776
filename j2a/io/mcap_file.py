"""The records of an MCAP file, as far as it goes.

What flows in: a file, which may be cut off, damaged or made to do harm. What flows out: its
records, one at a time.
Rules: no more memory than one chunk takes, and work in proportion to the length of the file,
whatever it says of itself; what is damaged is left out and noted, and what stands behind it is
read. Chunks that zstd or lz4 compressed need packages that come with mcap
(`pip install "j2a[record]"`).
"""

import struct
import zlib
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

from j2a.errors import LocalError

__all__ = ["END", "LATEST_NS", "About", "ChannelRecord", "McapFile", "MessageRecord"]

_MAGIC: Final = b"\x89MCAP0\r\n"
_FOOTER, _CHANNEL, _MESSAGE, _CHUNK, _METADATA = 0x02, 0x04, 0x05, 0x06, 0x0C
_DATA_END: Final = 0x0F
_HEAD: Final = struct.Struct("<BQ")
END: Final = _HEAD.pack(_DATA_END, 4) + bytes(4) + _HEAD.pack(_FOOTER, 20) + bytes(20) + _MAGIC
"""Of a file without an index, which readers then read from its start."""
_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
_CHUNK_HEAD: Final = struct.Struct("<QQQI")
_TIMES: Final = struct.Struct("<QQ")
"""The start of that: when the first and the last message of the chunk were logged."""
_PIECE_BYTES: Final = 1 << 16
_MOST: Final = {_FOOTER: 1 << 10, _DATA_END: 1 << 10, _CHANNEL: 1 << 20, _METADATA: 1 << 20}
_MOST_BYTES: Final = 1 << 26
"""Of a message, and of a chunk before and after its compression."""
_MOST_TIMES: Final = 512
"""So much longer a chunk may be than its compression; the dullest samples come to 140 times."""
LATEST_NS: Final = 1 << 63
"""Times fit into a signed number, as tables and messages of others have them."""


class ChannelRecord(NamedTuple):
    """Says what the messages of a channel are."""

    id: int
    about: dict[str, str]


class MessageRecord(NamedTuple):
    """A message, with the time when it was logged in nanoseconds since 1970."""

    channel: int
    sequence: int
    time_ns: int
    data: bytes


class About(NamedTuple):
    """A record of metadata."""

    name: str
    about: dict[str, str]


_Record = ChannelRecord | MessageRecord | About


class _DamagedError(ValueError):
    """What is read is not what MCAP says."""


class McapFile:
    """The records of a file.

    Args:
        path: of the file.

    Attributes:
        is_whole: the file has its end; known when all was read.
        problems: how many parts were damaged, and left out.
        problem: what was wrong with the first of them, or "".
        times_ns: of the first and the last message, as chunks say that were left out; None where
            none did.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._crc: int | None = None
        self.is_whole = False
        self.problems = 0
        self.problem = ""
        self.times_ns: tuple[int, int] | None = None

    def damaged(self, why: object) -> None:
        """Note that a part was left out."""
        self.problem = self.problem or str(why)
        self.problems += 1

    def records(self, *, chunks: bool = True) -> Iterator[_Record]:
        """Yield the channels, messages and metadata, in the order of the file.

        Args:
            chunks: False leaves the chunks out, in which all messages of a recording are. It takes
                a moment only, and it needs no index, which a file that ends early does not have.

        Raises:
            LocalError: it is no MCAP file, or a package is missing that its chunks need.
            OSError: it cannot be read.
        """
        with self._path.open("rb") as file:
            self._crc = 0 if chunks else None
            magic = self._read(file, len(_MAGIC))
            if not _MAGIC.startswith(magic):
                raise LocalError(f"{self._path} is no MCAP file")
            size = file.seek(0, 2)
            file.seek(len(magic))
            while True:
                crc, head = self._crc, self._read(file, _HEAD.size)
                if len(head) < _HEAD.size:
                    return  # whoever wrote it was killed
                opcode, length = _HEAD.unpack(head)
                if length > size - file.tell():
                    return
                if opcode == 0:
                    # What a file system keeps of a file when the power fails may end in zeros.
                    if any(head) or any(file.read(_PIECE_BYTES)):
                        self.damaged(f"there is no record at {file.tell()}")
                    return
                if opcode == _CHUNK and not chunks:
                    self._note_times(self._read(file, min(length, _TIMES.size)))
                    file.seek(max(0, length - _TIMES.size), 1)
                    continue
                if opcode not in (_CHUNK, _MESSAGE) and opcode not in _MOST:
                    self._skip(file, length)
                    continue
                if length > _MOST.get(opcode, _MOST_BYTES):
                    self.damaged(f"a record has {length} bytes")
                    self._skip(file, length)
                    continue
                content = self._read(file, length)
                if opcode == _FOOTER:
                    self.is_whole = self._read(file, len(_MAGIC)) == _MAGIC
                    return
                try:
                    if opcode == _DATA_END:
                        # Damage that was found is not told of twice.
                        _check_crc("the file", content[:4], None if self.problems else crc)
                    elif opcode == _CHUNK:
                        yield from _in_chunk(content)
                    else:
                        yield _record(opcode, content)
                except _DamagedError as error:
                    self.damaged(error)

    def _note_times(self, head: bytes) -> None:
        if len(head) == _TIMES.size:
            first_ns, last_ns = _TIMES.unpack(head)
            if not last_ns or not first_ns <= last_ns < LATEST_NS:
                return  # of a chunk without messages both are 0; others are damage
            known = self.times_ns or (first_ns, last_ns)
            self.times_ns = min(first_ns, known[0]), max(last_ns, known[1])

    def _read(self, file: IO[bytes], length: int) -> bytes:
        data = file.read(length)
        if self._crc is not None:
            self._crc = zlib.crc32(data, self._crc)
        return data

    def _skip(self, file: IO[bytes], length: int) -> None:
        if self._crc is None:
            file.seek(length, 1)
        while self._crc is not None and length:
            length -= len(self._read(file, min(length, _PIECE_BYTES)))


def _record(opcode: int, content: bytes) -> _Record:
    if opcode == _MESSAGE:
        if len(content) < _MESSAGE_HEAD.size:
            raise _DamagedError("a message is too short")
        channel, sequence, time_ns, _ = _MESSAGE_HEAD.unpack_from(content)
        if time_ns >= LATEST_NS:
            raise _DamagedError(f"a message has the time {time_ns} ns")
        return MessageRecord(channel, sequence, time_ns, content[_MESSAGE_HEAD.size :])
    fields = _Fields(content)
    if opcode == _METADATA:
        return About(fields.text(), fields.texts())
    number = fields.number(2)
    fields.take(2)  # the schema
    fields.text()  # the topic
    fields.text()  # the encoding
    return ChannelRecord(number, fields.texts())


def _in_chunk(content: bytes) -> Iterator[_Record]:
    fields = _Fields(content)
    _, _, size, crc = _CHUNK_HEAD.unpack(fields.take(_CHUNK_HEAD.size))
    compression = fields.text()
    packed = fields.take(fields.number(8))
    if size > min(_MOST_BYTES, _MOST_TIMES * len(packed)):
        raise _DamagedError(f"a chunk has {size} bytes, and {len(packed)} of compression")
    data = _unpacked(compression, packed, size)
    if len(data) != size:
        raise _DamagedError("a chunk does not have the length that it says")
    _check_crc("a chunk", crc.to_bytes(4, "little"), zlib.crc32(data))
    records = _Fields(data)
    while not records.is_over:
        opcode, length = _HEAD.unpack(records.take(_HEAD.size))
        if opcode == 0:
            raise _DamagedError("a chunk has a part without a record")
        one = records.take(length)
        if opcode in (_CHANNEL, _MESSAGE):
            yield _record(opcode, one)


def _unpacked(compression: str, packed: bytes, size: int) -> bytes:
    """Return what a chunk holds, so many bytes at most and one more."""
    if not compression:
        return packed
    try:
        if compression == "zstd":
            reader: Any = _module("zstandard", compression).ZstdDecompressor()
            return bytes(reader.stream_reader(packed).read(size + 1))
        if compression == "lz4":
            reader = _module("lz4.frame", compression).LZ4FrameDecompressor()
            return bytes(reader.decompress(packed, max_length=size + 1))
    except LocalError:
        raise
    except Exception as error:  # whatever the packages raise for damaged bytes
        raise _DamagedError(f"a chunk cannot be unpacked: {error}") from None
    raise LocalError(f"its chunks are compressed by {compression!r:.40}, which nobody reads here")


def _module(name: str, compression: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        what = f"this recording is compressed by {compression}"
        raise LocalError(f'{what}: pip install "j2a[record]"') from None


def _check_crc(what: str, told: bytes, found: int | None) -> None:
    """Compare a checksum, of which 0 is none."""
    number = int.from_bytes(told, "little")
    if number and found is not None and number != found:
        raise _DamagedError(f"the checksum of {what} is wrong")


class _Fields:
    """Takes the fields of a record, one after the other."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def is_over(self) -> bool:
        return self._at == len(self._data)

    def take(self, length: int) -> bytes:
        found = self._data[self._at : self._at + length]
        if len(found) != length:
            raise _DamagedError("a record is too short")
        self._at += length
        return found

    def number(self, length: int) -> int:
        return int.from_bytes(self.take(length), "little")

    def text(self) -> str:
        try:
            return self.take(self.number(4)).decode()
        except UnicodeDecodeError:
            raise _DamagedError("a text is not in UTF-8") from None

    def texts(self) -> dict[str, str]:
        inner = _Fields(self.take(self.number(4)))
        found = {}
        while not inner.is_over:
            key = inner.text()
            found[key] = inner.text()
        return found
