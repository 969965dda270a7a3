"""Rendering of models that no single process holds: rays are sent to the workers that hold the parts they may hit.

All samples of a piece of the image run until they need an intersection. Their rays are sent to the holders in one wave;
the nearest hits are kept, and the samples continue to their next intersection.

spread : whether models are spread over workers
wave : the samples of one piece of an image: rays to send, hits that workers return
replay : rendering kernels that read hits from a table, and stop at the first missing one
route : selection of holders by the boxes that a ray enters
answer : the intersection kernel of the holders
ray_exchange : several pieces at once, on the workers of a cluster

Begin with wave.
"""
