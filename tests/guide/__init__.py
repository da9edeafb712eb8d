"""How the network of ``flora_common.vision.path.guide`` is made: plants to learn from, training, whole numbers.

``make guide`` does it all, in an hour and a quarter on two cores, and writes ``guide.npz``. Three kinds of plants are
learnt from: the virtual box's, the drawings that stem finders are tuned on, and wild ones, which look like no plant in
particular.
Seeds from 90001 to 99999, which finders are judged on, and 1 to 79999, on which they are tuned, are not among them.
"""
