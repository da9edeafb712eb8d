"""How the network of ``flora_common.vision.path.guide`` is made: plants to learn from, training, whole numbers.

``make guide`` does it all, in some five hours on two cores that do nothing else, and writes ``guide.npz``; where torch
finds a graphics card that learns while the processors draw, in a quarter of an hour. Plants are learnt from that are
the virtual box's, the drawings that stem finders are tuned on, and such as are drawn for learning alone: wild ones,
which look like no plant in particular, misleading ones, ones modelled in three dimensions, and flowering stalks.
Decision 0018 says how the weights in the package were made. ``make guide-ends`` makes ``apex_error.npz`` of further
plants.
Seeds from 90001 to 99999, which finders are judged on, and 1 to 79999, on which they are tuned, are not among them.
"""
