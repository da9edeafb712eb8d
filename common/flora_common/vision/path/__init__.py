"""The stem as one line from anchor to growing tip, to a fraction of a pixel.

:mod:`.evidence` says how much each pixel looks like plant, :mod:`.strands` finds the thin pieces in it, :mod:`.chain`
puts together those that are the stem, :mod:`.curve` lays a smooth line through their middle, :mod:`.tip` finds its end,
:mod:`.forks` and :mod:`.looks` tell when it ran into a leaf, and :mod:`.tracker` does it picture after picture.
"""
