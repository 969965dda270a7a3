"""Pictures of scans by several programs, measured by `bench/beside.py`.

peers : the programs, their settings and where these come from; measure : seconds, memory, lines and silhouettes;
launch : runs and measures one program; page : docs/comparison.md and its pictures; scripts/ : one program each
"""
