"""What can keep a record from being written."""

from revnm_client.errors import RevnmError


class RecordingError(RevnmError):
    """Nothing can be recorded now; the text says what to mend."""
