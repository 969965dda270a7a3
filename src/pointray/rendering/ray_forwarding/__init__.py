"""Pictures of models that no single process holds: rays travel to those who hold what they may meet, wave by wave.

A wave is what all samples in the works ask next: each one tile of rays. Whoever holds parts answers those rays that
meet them, the nearest hits are joined, and the samples go on to their next question.

spread : whether it is wanted, and possible
recall : the kernels of pictures, which take hits from a table of answers; where they have none they ask, and end
answer : the kernel of those who hold parts
route : which rays meet what somebody holds
wave : one piece of a picture, wave after wave
travel : several pieces at once, by workers of a cluster or by holders in this process

Begin with wave.
"""
