"""Furnished rooms from a seed, seen by a hand-held camera: exact poses, depth and surface, with no file to download.

    scene, site                              what there is: solids, materials, lights; a room while it is furnished
    furniture, home, workplace, fittings     pieces
    living_room, bedroom, dining_room, lounge, study, meeting_room, open_office, seminar_room, office_walls, rooms
                                             the eight rooms
    solids, bvh, distance                    rays and distances
    noise, textures, pictures, prints, shading, lighting    colour and light
    motion, statistics, tracer, sensor, mesh, cache, dataset    walk, frames, imperfections, surface, disk, Dataset

Nothing is imported here: the ray caster's compiler is loaded when a room is built.
"""
