"""The commands of ``revnm-server``, a module each: ``add_arguments(parser)`` and ``run(options) -> exit status``."""
