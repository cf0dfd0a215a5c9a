"""A valve watched stroke by stroke: segmentation, scores, control charts, fault isolation."""
