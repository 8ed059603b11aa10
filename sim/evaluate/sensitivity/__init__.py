"""How sensitive the search's answers are to its tuned constants: each is halved and doubled, and the same cases located anew.

``constants`` lists what is tuned, ``variant`` makes a copy of the localizer with one constant changed, ``worker`` locates the
cases with such a copy, ``run`` does so for all of them, ``table`` sums up.
"""
