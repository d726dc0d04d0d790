"""Print a script that lets the shell complete mmqa's commands, options and files.

Put its output where the shell looks for completions, or evaluate it from the shell's start file.
"""

from pathlib import Path

SUMMARY = "print shell completion for bash, zsh or tcsh"

EPILOG = """\
example:
  mmqa completion bash > ~/.local/share/bash-completion/completions/mmqa
  mmqa completion zsh > ~/.zfunc/_mmqa
"""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"), metavar="SHELL")


def run(options):
    """Print the script."""
    import shtab

    from mmqa_lab.__main__ import parser

    whole = parser()
    for command in whole._subparsers._group_actions[0].choices.values():
        for action in command._actions:
            if action.type is Path or action.metavar in ("FILE", "CLOUD", "IMAGE"):
                action.complete = shtab.FILE
    print(shtab.complete(whole, shell=options.shell))
