"""Images of articulated pills with exact truth: motion -> scene -> rays -> shading -> sensor -> sequence folder."""
