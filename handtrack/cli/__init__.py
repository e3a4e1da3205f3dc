"""The command line: arguments in, exit code out. Commands are thin; the work is in the library."""

from .commands import app as app
from .commands import main as main
