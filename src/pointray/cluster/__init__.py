"""Pictures and films on Dask: everything that knows Dask, which is imported only when somebody asks for it.

client : which clients are taken; LocalCluster and schedulers for the command line
recipe : a scene without its models -> bytes, and back
parcels : what is sent to workers once: models, baked light, recipes
worker : what runs on a worker
crew : the workers at work on a scene
dispatch : which worker does which job, again where one has died or is slow

What jobs do is not known here: `rendering/pieces.py` and `rendering/sequence.py` make them. Begin with crew.
"""
