"""The commands of ``revnm-robot``, one a module: ``add_arguments`` declares its options, ``run`` carries it out."""
