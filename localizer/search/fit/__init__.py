"""The fit of a place between the cells: its unknowns, its likelihood, and the search for its optima.

``problem`` (at several numbers of columns: ``problems``) has the observation: one elevation angle for each image column, and
a Gaussian prior for each unknown but the position. Unknown are the position (east, north), the altitude of the camera, the
biases of azimuth and tilt that all frames share, and azimuth, tilt and roll errors of each frame.

``residuals`` evaluates observed minus predicted elevation, and its derivatives. ``outliers`` sorts the columns: *informative*
ones count; *occluded* ones show something nearer than the DEM resolves; at *undetermined* ones near terrain and horizon are
too close to tell apart; columns at the *DEM edge* have an unknown horizon. Among the informative ones, outliers have little
weight (Geman-McClure).

``correlated_errors`` is the error model of the DEM. Errors of neighbouring columns that see the same ridge are correlated along
the ground, so that a near ridge, which fills many columns with few cells, counts for few samples. The residuals are whitened by
a Kalman filter. ``noise`` estimates the parameters of the model from the residuals, at first robustly, later by maximum
marginal likelihood. ``objective`` adds up the negative log-posterior.

``refine`` minimises it (Gauss-Newton with Levenberg-Marquardt damping) and returns a ``Refined``: the place, its covariance and
its evidence. ``local_grid`` evaluates a grid of places around a fit, ``local_optima`` uses it to find the other optima nearby,
refits from each, and averages over those that are about as likely. What may be wrong: an optimum farther off than the grid
reaches is not found here; it has to come from another starting cell.
"""
