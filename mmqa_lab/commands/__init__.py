"""The command line, a module for each command.

A module has a docstring (the manual page), ``SUMMARY`` (its line in ``mmqa --help``), ``EPILOG``
(an example), ``ARGUMENTS`` and ``run(options)``, which returns an exit status or None for success
and raises what the rooms raise: one sentence. At the top it imports the standard
library alone, so that help needs no environment.
"""
