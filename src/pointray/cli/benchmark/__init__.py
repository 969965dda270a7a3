"""pointray bench: the paper's frame rates beside those of this computer.

frames : the measured cases
views : the cameras
show : the table as text, JSON or a plot

Begin with frames.
"""

from .frames import measure as measure
from .show import check_plot as check_plot, plot as plot, show_rows as show_rows
