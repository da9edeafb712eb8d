"""The stem as one line from anchor to growing tip, to a fraction of a pixel.

:mod:`.evidence` says how much each pixel looks like plant, and in :mod:`.guide` a network says from that where stem and
apex are. :mod:`.along_way` measures the stem along the network's way. Where the network is not sure, rules go on:
:mod:`.strands` finds the thin pieces, :mod:`.chain` puts together those that are the stem, :mod:`.tip` finds its end,
:mod:`.forks` and :mod:`.looks` tell when it ran into a leaf. :mod:`.curve` lays a smooth line through the middle of
either, :mod:`.fit` chooses between them and holds that against the picture before, :mod:`.apex` finds the apex of the
picture before again by how it looks, and :mod:`.tracker` does it all picture after picture.
"""
