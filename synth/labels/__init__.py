"""Images with exact labels: solids in, image, depth, normals, parts, flow, keypoints and what hides them out."""
