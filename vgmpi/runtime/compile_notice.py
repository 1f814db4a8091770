"""What is done, once, when numba begins to compile."""

import logging
from collections.abc import Callable

from numba.core import event


def call_at_first_compilation(action: Callable[[], object]) -> None:
    """Call a function when numba compiles for the first time from now on; cached code is silent.

    Args:
        action: The function.
    """

    class FirstCompilation(event.Listener):
        """Listener that calls the function at the first compilation."""

        is_called = False

        def on_start(self, _):
            """Call the function unless it was."""
            if not self.is_called:
                self.is_called = True
                action()

        def on_end(self, _):
            """Do nothing."""

    event.register("numba:compile", FirstCompilation())


def announce_compiling(log: logging.Logger, message: str) -> None:
    """Log a message when numba compiles for the first time from now on.

    Args:
        log: The logger.
        message: The message.
    """
    call_at_first_compilation(lambda: log.info("%s", message))
