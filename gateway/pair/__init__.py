"""Two arms, one workpiece: the slave follows the master through a relation that is learned along the path.

After CN104379308. What carries the coordination is arithmetic without bus, clock or files:

- `transform`, `transform_function`, `path`: poses, eqs. (3) and (4), the relation as a function of arc length, per
speed and as a file, the path;
- `inverse`, `force`, `calibration`: joint positions for poses, force from joint torque, its internal part, its limit;
- `impedance`, `distance`: how a hand yields, distance instead of force;
- `learning_update`, `learning_points`, `iterative_learning`: what is learned from corrections, and where;
- `controller`: all embodiments as configurations, run one control cycle at a time.

The other modules put it on two buses: cell file, teaching, running, what is kept.
"""
