"""Export of particles: VTKHDF files for ParaView, and pictures."""

from fluidsnet.export.render import Panel as Panel
from fluidsnet.export.render import side_by_side as side_by_side
from fluidsnet.export.vtkhdf import TrajectoryFile as TrajectoryFile
from fluidsnet.export.vtkhdf import read_field_data as read_field_data
from fluidsnet.export.vtkhdf import read_frame as read_frame
