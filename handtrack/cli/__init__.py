"""The command line: arguments in, exit code out. Commands are thin; the work is in the library."""

from .app import app as app
from .app import main as main
