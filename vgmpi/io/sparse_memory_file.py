"""File in memory, in which HDF5 lays a file out without its rows."""

import io


class SparseMemoryFile(io.RawIOBase):
    """File in memory that holds only the pages written to; the rows are holes in it."""

    PAGE = 1 << 16

    def __init__(self):
        self.pages: dict[int, bytearray] = {}
        self.place, self.size = 0, 0

    def readable(self):
        """Return True."""
        return True

    def writable(self):
        """Return True."""
        return True

    def seekable(self):
        """Return True."""
        return True

    def seek(self, place, whence=io.SEEK_SET):
        """Set and return the position."""
        self.place = place + (0, self.place, self.size)[whence]
        return self.place

    def tell(self):
        """Return the position."""
        return self.place

    def truncate(self, size=None):
        """Set the size, by default to the position."""
        self.size = self.place if size is None else size
        return self.size

    def _ranges(self, count):
        """Yield (page number, first and last byte in it, first byte of the request)."""
        place, end = self.place, self.place + count
        while place < end:
            page, first = divmod(place, self.PAGE)
            last = min(self.PAGE, first + end - place)
            yield page, first, last, place - self.place
            place += last - first

    def readinto(self, buffer):
        """Read bytes from the position on; holes are zeros."""
        view = memoryview(buffer).cast("B")
        count = max(0, min(len(view), self.size - self.place))
        for page, first, last, offset in self._ranges(count):
            data = self.pages.get(page, bytes(self.PAGE))
            view[offset : offset + last - first] = data[first:last]
        self.place += count
        return count

    def write(self, data):
        """Write bytes from the position on."""
        view = memoryview(data).cast("B")
        for page, first, last, offset in self._ranges(len(view)):
            if page not in self.pages:
                self.pages[page] = bytearray(self.PAGE)
            self.pages[page][first:last] = view[offset : offset + last - first]
        self.place += len(view)
        self.size = max(self.size, self.place)
        return len(view)

    def written(self):
        """Yield (position, bytes) of the pages, cut at the end of the file."""
        for page, data in sorted(self.pages.items()):
            start = page * self.PAGE
            if start < self.size:
                yield start, memoryview(data)[: self.size - start]
