"""From frames to a scene: accuracy, scale, loops, matching, movers, time."""
