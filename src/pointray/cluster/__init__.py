"""Work on Dask: everything that knows Dask, which is imported only when somebody asks for it.

arrays, stowed : arrays of Dask, whose chunks are made when they are computed; the scene as their graphs carry it
client : which clients are taken; LocalCluster and schedulers for the command line
recipe : what is asked of a scene; a scene without its models -> bytes, and back
parcels : what is sent to workers once: models, baked light, recipes
worker : what runs on a worker
crew : the workers at work on a scene
chores : functions that workers call with numbers, such as those of parts, without a scene
dispatch : which worker does which job, again where one has died or is slow

What jobs do is not known here: `rendering/pieces.py`, `rendering/sequence.py` and `baking/tile_ranges.py` make them, and
`model/out_of_core/work.py` chores. Nor is what chunks are: see `scene/casting.py`. Begin with crew.
"""
