"""Datasets of any size: a scene file and a seed in, labelled images in shards, folders and COCO files out."""
