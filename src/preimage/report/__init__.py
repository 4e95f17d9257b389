"""From records and results to what people look at: films, figures and one page that holds them.

A film shows the goal, the imagined way to it and what the camera saw on that way; a figure shows the same as a strip of frames above
the joint curves; a page gathers the counts of an evaluation, its baselines and some cases. This room knows records and JSON only:
no model, no robot.

>>> import tempfile
>>> import numpy as np
>>> from preimage.records import Percept, Plan, Stopped
>>> from preimage.report.figures import figure
>>> from preimage.report.films import film
>>> frames, joints = np.zeros((5, 8, 8, 1), np.uint8), np.zeros((5, 2))
>>> start, goal = Percept(frames[0], joints[0]), Percept(frame=frames[3])
>>> errors = np.array([2.0, 1.0])
>>> plan = Plan(frames, joints, 3, 10.0, ("yaw", "shoulder"), start, goal, 1.0, errors, Stopped.ITERATIONS, 0.5, np.zeros(1))
>>> with tempfile.TemporaryDirectory() as folder:
...     film(plan, None, f"{folder}/reach.gif").name, figure(plan, None, f"{folder}/reach.png").name
('reach.gif', 'reach.png')
"""
