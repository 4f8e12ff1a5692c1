"""The scanner: field of view, rays, surface samples, the coverage certificate."""
