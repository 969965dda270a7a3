# The public names, each imported from its module on first use: `lazy_loader` reads this file.

from .auto_view.first_view import frame as frame
from .auto_view.splats import write_splats as write_splats
from .auto_view.studio import studio as studio
from .baking.baked import Baked as Baked, StaleLightWarning as StaleLightWarning, bake as bake
from .baking.settings import BakeSettings as BakeSettings
from .base.version import __version__ as __version__
from .cloud.cleaning import Flaws as Flaws, clean as clean, find_flaws as find_flaws
from .cloud.conversion import as_points as as_points
from .cloud.denoising.smooth import smooth as smooth
from .cloud.georeference import Georeference as Georeference
from .cloud.normals.comparison import NormalsCheck as NormalsCheck, check_normals as check_normals
from .cloud.normals.estimate import estimate_normals as estimate_normals
from .cloud.outliers import Strays as Strays, find_strays as find_strays, merge_layers as merge_layers
from .cloud.points import Points as Points
from .image import draw_legend as draw_legend, write_image as write_image, write_layers as write_layers
from .io.files import read as read, write as write
from .io.known_formats import FormatFacts as FormatFacts, formats as formats
from .io.trajectory import Trajectory as Trajectory, eyes_along as eyes_along
from .model.model import Model as Model
from .model.preparation import Prepared as Prepared, prepare as prepare
from .procedural_models import procedural as procedural, procedural_distance as procedural_distance
from .rendering.camera import Camera as Camera
from .rendering.camera_path import fly as fly, turntable as turntable
from .rendering.layer_dataset import Layers as Layers
from .rendering.layers import render_layers as render_layers
from .rendering.picture import render as render
from .rendering.sequence import animate as animate
from .rendering.settings import Settings as Settings
from .scene.instances import Plane as Plane
from .scene.rays import Hits as Hits
from .scene.scene import Scene as Scene
from .scene.transforms import transform as transform
from .scenefile import SceneFile as SceneFile, load_scene as load_scene
from .shade.attributes import Attribute as Attribute
from .shade.environment import EnvironmentLight as EnvironmentLight
from .shade.lights import (
    DiskLight as DiskLight,
    PointLight as PointLight,
    RectLight as RectLight,
    SphereLight as SphereLight,
    SunLight as SunLight,
)
from .shade.materials.diffuse import Diffuse as Diffuse, Emissive as Emissive
from .shade.materials.phong import Phong as Phong
from .shade.materials.principled import Principled as Principled
from .shade.materials.specular import Dielectric as Dielectric, Mirror as Mirror
from .surface.splats.subsample import subsample as subsample
from .viewer import Viewer as Viewer, view as view
from .viewer.notebook.widget import ViewerWidget as ViewerWidget
