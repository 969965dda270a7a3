"""From files to models: reading, neighbours, normals, stages, memory."""
