"""Execution on Dask's workers. Only this folder depends on Dask; it is imported when a client or a Dask array is given.

backend : the interface to other folders, see `base/executor.py`
client : validation of clients; clients for the command line, from a LocalCluster or a scheduler's address
worker_pool : the workers of a client for jobs on one scene; task_pool : workers that call functions with numbers
shared_folder : workers that share a folder with this machine
dispatch : assignment of jobs to workers, and retries after lost or slow workers
worker : code that runs on a worker
recipe : serialization of a scene without its models
scattered_objects : objects sent to workers once: models, baked light, recipes
serialized_scene : a scene in the graph of a Dask array
dask_arrays, dask_casting : Dask arrays computed from a scene; rays in Dask arrays

Jobs are defined in `rendering/pieces.py`, `rendering/sequence.py` and `baking/tile_ranges.py`, tasks in
`model/out_of_core/work.py`. Begin with worker_pool.
"""
