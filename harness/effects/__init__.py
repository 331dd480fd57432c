"""Effects: what a scene calls for, and what has to be built, traced and evaluated for it.

An effect is one small object (:class:`Effect`); the registry reads a scene's list of them and
makes one :class:`Recipe`, from which a renderer builds. Plain data: no renderer is loaded here.
"""
