"""Frozen answers: what the search answers to some 300 cases, kept in a file, and the comparison with what it answers now.

``python -m frozen_answers`` (``make answers``) makes the input of every case from a seed, searches, and compares.
`cases` makes the inputs, `answer` takes down what came out, `run` computes many in processes, `compare` tells what differs.
"""
