"""Speed and memory, as ratios against a plain reference in the same run."""
