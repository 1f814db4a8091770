"""A command that serves a page, as a process of its own."""

import re
import sys
import threading

import pytest

from tests.support.launch import PATIENCE, start


class PageProcess:
    """`vgmpi WORDS` as a process: the address that its first line tells, and its lines."""

    def __init__(self, *words):
        self.process = start([sys.executable, "-m", "vgmpi", *words])
        line = self.process.stdout.readline()
        match = re.search(r"http://\S+", line)
        if match is None:
            pytest.fail(f"no address: {line}{self.process.stderr.read()}")
        self.address = match[0]

    def wait(self):
        """Exit code, stdout and stderr of the process that has been ended."""
        out, err = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, out, err

    def stop(self, number):
        """Send a signal and return exit code, stdout and stderr."""
        self.process.send_signal(number)
        return self.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.terminate()
            killer = threading.Timer(PATIENCE, self.process.kill)
            killer.start()
            self.process.communicate()
            killer.cancel()
