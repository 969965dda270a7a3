"""Executors over Dask's workers. Everything that knows Dask is here; it is imported when a client is given.

backend : what other rooms ask of a cluster, see `base/executor.py`
client : validation of clients; clients for the command line: a LocalCluster or a scheduler's address
worker_pool : the workers at work on one scene; task_pool : workers that call functions with numbers
shared_folder : workers who see a folder of this machine
dispatch : which worker does which job; jobs of lost or slow workers are done again
worker : what runs on a worker
recipe : a scene without its models as bytes, and back
scattered_objects : what is sent to workers once: models, baked light, recipes
serialized_scene : a scene as the graph of a Dask array carries it
dask_arrays, dask_casting : Dask arrays whose chunks are made of a scene; the rays in them

What jobs do is not known here: `rendering/pieces.py`, `rendering/sequence.py` and `baking/tile_ranges.py` make jobs,
`model/out_of_core/work.py` makes tasks. Begin with worker_pool.
"""
