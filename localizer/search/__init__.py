"""The search for the place in a DEM from which the observed skyline is seen.

Input is an ``Observation``: the skyline's points in each frame, the camera's attitude by compass and inclinometer, and the
altitude. Output is a ``Decision``: ``fix``, ``ambiguous`` or ``none``, with places, covariances and probabilities. The method
is that of Talluri and Aggarwal (1992), whose two stages are followed by a refinement between the grid points.

1. ``contours``. Where does the skyline lie in the world? Pixels become directions by the camera model and the measured
   attitude. Handed on: elevation, sigma and slope over the measured azimuth, in bins of 0.25 degrees. What may be wrong: an
   error of the heading shifts all azimuths alike. It stays unknown until the fit; stages 1 and 2 try hypotheses for it.
2. ``stage1`` (the paper, section IV-A). Which cells can hold the camera? A cell stays if its ground lies at the measured
altitude
   and if, in the central column of each frame, the horizon of the terrain has the measured height within an error band.
   Handed on: the cells left, typically some hundreds of a million. What may be wrong: a central column may show a cloud or a
   tree, so that the true cell is lost. Then nothing fits, and stage 2 is run again over all cells at the right altitude.
3. ``coarse_to_fine`` and ``stage2`` (section IV-B). Which of these cells fit the whole curve? Their horizons are compared with
   the measured skyline by a robust disparity, first at few azimuths, then, for the best cells, at more. Handed on: some
   hundreds of cells in order, and how probable it is that the true cell was cut off on the way.
4. ``selection`` with the package ``fit``. Where between the cells is the camera, and how well does each place explain the
   observation? Coarse fits start from the best cells; the best of their places are short-listed, fitted with more columns, and
   those that could still be the most probable are refined with all columns. Each fit solves for place, altitude, biases and
   the DEM's error together. Handed on: a few places, each with a covariance and its *evidence*, the logarithm of the Bayes
   factor of this place against an unrelated one. What may be wrong: the likelihood has many local optima where hills are near.
   A grid search around each fit finds the others; they move the answer to their mean and widen its covariance.
5. ``compare``. Which place is the most probable? The places are fitted with the same columns, from the same starts. Similar
   surroundings give similar evidence, and the error model is only approximately right: log-odds count by half.
6. ``decide`` and ``reasons``. Is the best place to be believed at all, and is it the only one? A place is rejected if the
   terrain explains the skyline hardly better than chance, or only with a DEM error, an outlier share or sensor errors beyond
   what is plausible: ``none``. Probabilities follow from the evidence and the width of each mode (Laplace approximation).
   Places that a limit excluded from the comparison keep their probability (``elsewhere``). One place with a probability of
   0.99 or more, enough evidence and a small covariance is a ``fix``; everything else is ``ambiguous``.
7. ``leave_one_out``. Does one frame contradict the others? If the result is no fix, or a frame fits badly, the search is
   repeated without that frame. The result is replaced only if all other frames then agree on a fix.
8. ``altitude_reference``. Is an altimeter with a wrong reference the cause of a ``none``? The search is repeated without the
   altitude, and the reason of the ``none`` says what that shows. It stays ``none``.

``locate`` runs all of this, ``answer`` puts the result into the terms of the contract, ``details`` keeps what plots and reports
need. A DEM that is declared exact (``--dem-error 0``) is searched like any other; only the last fit treats it as exact, and
only if it then fits (``selection.refined_on_exact_dem``). ``grid_only`` is the paper's own estimate, for comparison.

No stage looks at the position of a cell or at its order, only at how well it fits. Two places with the same surroundings are
kept or cut together. The constants that were tuned say on what; ``sim sensitivity`` halves and doubles them
(docs/sensitivity.md). Terms are explained in the glossary (docs/glossary.md).
"""
