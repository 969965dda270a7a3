"""Render the conda recipe, which reports unknown keys and invalid values: python .ci/lint_recipe.py RECIPE"""

import sys

from rattler_build import Stage0Recipe

for variant in Stage0Recipe.from_file(sys.argv[1]).render():
    print(f"{sys.argv[1]}: {variant.recipe}")
