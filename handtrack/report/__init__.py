"""Track in; overlay video and one self-contained HTML page out."""

from .overlay import draw_overlay as draw_overlay
from .overlay import write_overlay as write_overlay
from .page import RunInfo as RunInfo
from .page import write_report as write_report
