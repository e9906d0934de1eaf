"""Every error that ReVNM raises on purpose.

The tree::

    RevnmError
    ├── ConfigError        a setting, an option or a name is wrong: the person who set it can mend it
    ├── ContractError      data from outside broke the contract
    │   ├── MessageError   a payload on the wire is malformed, out of range or absurd
    │   └── FileError      a file is malformed: world, bundle, episode, checkpoint
    └── LinkError          the other end cannot be reached

Packages above add leaves where the caller needs to tell cases apart, such as
``revnm_sim.expert.planner.UnreachableError``.
"""


class RevnmError(Exception):
    """Base of all errors that ReVNM raises on purpose; its text speaks to the person who can act."""


class ConfigError(RevnmError):
    """A setting, an option or a name is wrong."""


class ContractError(RevnmError):
    """Data from outside broke the contract."""


class MessageError(ContractError):
    """A payload on the wire is malformed, out of range or absurd; it is counted and dropped."""


class FileError(ContractError):
    """A file is malformed; the text names the file, the place in it and what was expected."""


class LinkError(RevnmError):
    """The other end cannot be reached."""
