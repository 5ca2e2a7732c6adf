"""What a chunk of a file holds, unpacked and checked: questions that go through a long recording do little else."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Final

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream
from zstandard import ZstdDecompressor

CHUNK_HEAD: Final = struct.Struct("<QQQII")  # start, end, size, crc; length of the compression's name that follows


#: What a damaged file can raise in the libraries that decode it.
DAMAGE: Final = (McapError, struct.error, ValueError, EOFError, OSError, LookupError, ArithmeticError, MemoryError)


class Unpacking:
    """Unpacks chunks one after the other; not for several threads at once."""

    def __init__(self) -> None:
        self._zstd = ZstdDecompressor()

    def contents(self, chunk: bytes) -> bytes:
        """The messages of a chunk.

        Args:
            chunk: the content of its record.

        Raises:
            Exception: it is damaged; what the decompressors raise has no common base.
        """
        _, _, size, crc, length = CHUNK_HEAD.unpack_from(chunk)
        start = CHUNK_HEAD.size + length
        if chunk[CHUNK_HEAD.size : start] != b"zstd":  # other recorders may choose; ours takes this
            stream, size = get_chunk_data_stream(Chunk.read(ReadDataStream(io.BytesIO(chunk))), validate_crc=True)
            return stream.read(size)
        data = self._zstd.decompress(memoryview(chunk)[start + 8 :], max_output_size=size)
        if crc and zlib.crc32(data) != crc:
            raise ValueError("its sum is not the one that it was written with")
        return data
