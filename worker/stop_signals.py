"""Why and by which signals a supervisor ends its training process.

They are here alone because the process handles them before it loads anything that takes time.
"""

import signal
from enum import StrEnum

# Finish the epoch, keep the work, make the video of how far it came, and exit.
STOP_SIGNAL = signal.SIGTERM
# The job continues elsewhere: a checkpoint, nothing else, and exit; at once where there is nothing new to
# keep. Said again and again until the process ends.
DRAIN_SIGNAL = signal.SIGUSR1


class Stop(StrEnum):
    """Why a training process was asked to stop."""

    CANCEL = "cancel"
    TIMEOUT = "timeout"
    DRAIN = "drain"
