"""The part: mesh, fixture with markers, place in the shop, scan settings; the sample parts."""
