"""Every source that docstrings cite, by its key.

- [Auton1988] T. R. Auton, J. C. R. Hunt, M. Prud'homme, The force exerted on a body in inviscid
  unsteady non-uniform rotational flow, Journal of Fluid Mechanics 197, 1988.
- [Bland1977] R. G. Bland, New finite pivoting rules for the simplex method, Mathematics of
  Operations Research 2(2), 1977.
- [Diehl2005] M. Diehl, H. G. Bock, J. P. Schlöder, A real-time iteration scheme for nonlinear
  optimization in optimal feedback control, SIAM Journal on Control and Optimization 43(5), 2005.
- [Dimitrov2015] D. Dimitrov, A. Sherikov, P.-B. Wieber, Efficient resolution of potentially
  conflicting linear constraints in robotics, preprint, 2015.
- [Ericson2005] C. Ericson, Real-Time Collision Detection, Morgan Kaufmann, 2005.
- [Escande2014] A. Escande, N. Mansard, P.-B. Wieber, Hierarchical quadratic programming: fast
  online humanoid-robot motion generation, International Journal of Robotics Research 33(7), 2014.
- [Fletcher1982] R. Fletcher, Second order corrections for non-differentiable optimization, in:
  Numerical Analysis, Lecture Notes in Mathematics 912, Springer, 1982.
- [Fossen2021] T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed.,
  Wiley, 2021.
- [Gao2022] H. Gao et al., UVMS task-priority planning framework for underwater task goal
  classification optimization, Frontiers in Neurorobotics 16, 982505, 2022.
- [Gilbert1988] E. G. Gilbert, D. W. Johnson, S. S. Keerthi, A fast procedure for computing the
  distance between complex objects in three-dimensional space, IEEE Journal on Robotics and
  Automation 4(2), 1988.
- [Hintermueller2002] M. Hintermüller, K. Ito, K. Kunisch, The primal-dual active set strategy as a
  semismooth Newton method, SIAM Journal on Optimization 13(3), 2002.
- [Kanoun2011] O. Kanoun, F. Lamiraux, P.-B. Wieber, Kinematic control of redundant manipulators:
  generalizing the task-priority framework to inequality task, IEEE Transactions on Robotics 27(4),
  2011.
- [Kuffner2000] J. J. Kuffner, S. M. LaValle, RRT-Connect: an efficient approach to single-query
  path planning, IEEE International Conference on Robotics and Automation, 2000.
- [Levenberg1944] K. Levenberg, A method for the solution of certain non-linear problems in least
  squares, Quarterly of Applied Mathematics 2(2), 1944.
- [Marquardt1963] D. W. Marquardt, An algorithm for least-squares estimation of nonlinear
  parameters, Journal of the Society for Industrial and Applied Mathematics 11(2), 1963.
- [Mehra1972] R. K. Mehra, Approaches to adaptive filtering, IEEE Transactions on Automatic Control
  17(5), 1972.
- [Mehrotra1992] S. Mehrotra, On the implementation of a primal-dual interior point method, SIAM
  Journal on Optimization 2(4), 1992.
- [Ng2009] M. Ng, L. Qi, G. Zhou, Finding the largest eigenvalue of a nonnegative tensor, SIAM
  Journal on Matrix Analysis and Applications 31(3), 2009.
- [Okabe2008] M. Okabe, K. Ito, Color universal design, J*FLY data depository for Drosophila
  researchers, 2008.
- [Patnaik1949] P. B. Patnaik, The non-central chi-squared and F-distributions and their
  applications, Biometrika 36, 1949.
- [Rucker2022] C. Rucker, P. M. Wensing, Smooth parameterization of rigid-body inertia, IEEE
  Robotics and Automation Letters 7(2), 2022.
- [Shepperd1978] S. W. Shepperd, Quaternion from rotation matrix, Journal of Guidance and Control
  1(3), 1978.
- [SimettiCasalino2016] E. Simetti, G. Casalino, A novel practical technique to integrate inequality
  control objectives and task transitions in priority based control, Journal of Intelligent &
  Robotic Systems 84, 2016.
- [Stark1995] P. B. Stark, R. L. Parker, Bounded-variable least-squares: an algorithm and
  applications, Computational Statistics 10, 1995.
- [Taylor1928] G. I. Taylor, The forces on a body placed in a curved or converging stream of fluid,
  Proceedings of the Royal Society A 120, 1928.
- [Waechter2006] A. Wächter, L. T. Biegler, On the implementation of an interior-point filter
  line-search algorithm for large-scale nonlinear programming, Mathematical Programming 106, 2006.
- [Willsky1976] A. S. Willsky, H. L. Jones, A generalized likelihood ratio approach to the detection
  and estimation of jumps in linear systems, IEEE Transactions on Automatic Control 21(1), 1976.
"""

from __future__ import annotations
