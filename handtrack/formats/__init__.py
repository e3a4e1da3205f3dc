"""Files in and out: model and camera files, images, videos, tables and tracks."""

from .cameras import read_camera as read_camera
from .cameras import read_cameras as read_cameras
from .model_writing import write_model as write_model
from .models import read_model as read_model
from .tracks import read_track as read_track
from .tracks import write_track as write_track
from .truths import read_truth as read_truth
from .urdf import export_urdf as export_urdf
from .writing import folder_written_whole as folder_written_whole
from .writing import write_bytes as write_bytes
from .writing import write_text as write_text
