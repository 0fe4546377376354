"""Furnished rooms from a seed, seen by a hand-held camera: exact poses, depth and surface, with no file to download.

    scene, furniture, rooms    what there is: solids, materials, lights; pieces; rooms
    solids, bvh, distance      rays and distances
    noise, textures, pictures, shading, lighting    colour and light
    motion, tracer, mesh, cache, dataset            walk, frames, surface, disk, Dataset

Nothing is imported here: the ray caster's compiler is loaded when a room is built.
"""
