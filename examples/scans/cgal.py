# python examples/scans/cgal.py building.ply
# python examples/scans/cgal.py b9_training.ply
#
# A building reconstructed from photographs, and a city block scanned from the air: data of CGAL, from Debian's package
# libcgal-demo (`apt-get install libcgal-demo`).
import sys
import tarfile
import tempfile
from pathlib import Path

import pointray as pr

ARCHIVE = "/usr/share/doc/libcgal-dev/data.tar.gz"

name = f"data/points_3/{Path(sys.argv[1]).name}"
with tempfile.TemporaryDirectory() as folder, tarfile.open(ARCHIVE) as archive:
    archive.extract(name, folder, filter="data")
    pr.write(sys.argv[1], pr.read(Path(folder) / name))
