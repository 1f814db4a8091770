"""Line that tells, once, that code is being compiled."""

import logging

from numba.core import event


def announce_compiling(log: logging.Logger, message: str) -> None:
    """Log a message when numba compiles for the first time from now on; cached code is silent.

    Args:
        log: The logger.
        message: The message.
    """

    class FirstCompilation(event.Listener):
        """Listener that logs at the first compilation."""

        is_logged = False

        def on_start(self, _):
            """Log the message unless it was."""
            if not self.is_logged:
                self.is_logged = True
                log.info("%s", message)

        def on_end(self, _):
            """Do nothing."""

    event.register("numba:compile", FirstCompilation())
