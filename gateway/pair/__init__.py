"""Two arms, one workpiece: the slave follows the master through a relation that is learned along the path.

After CN104379308. What carries the coordination is arithmetic without bus, clock or files:

- `transform`, `relation`, `function`, `path`: poses, eqs. (3) and (4), the relation as a function of arc length, the
path;
- `inverse`, `force`, `calibration`: joint positions for poses, force from joint torque, its internal part;
- `impedance`, `adjust`, `distance`, `guard`: how a hand yields, teaching, distance instead of force, the limit;
- `representative`, `store`, `selection`, `learning`, `learner`: what is learned from corrections, and where;
- `speed`, `streaming`, `stored`: functions per speed, blended and filtered commands, functions as files;
- `embodiments`, `controller`: all embodiments as configurations, run one control cycle at a time.

The other modules put it on two buses: cell file, teaching, running, what is kept.
"""
