"""Pictures of models that no single process holds: rays are sent to the holders of the parts that they may hit.

All samples of a piece of the picture run until each needs an intersection. Their rays are sent to the holders in one
wave; the nearest of the answers is kept, and the samples continue to their next intersection.

spread : whether models are spread over workers
wave : one piece of a picture, wave after wave
replay : the kernels of pictures; they read hits from a table of answers, and stop at the first that is missing
route : the holders whose boxes a ray meets
answer : the kernel of the holders
ray_exchange : several pieces at once, on the workers of a cluster

Begin with wave.
"""
