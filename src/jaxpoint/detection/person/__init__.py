"""People in images: silhouettes, heads, skin, markers, landmarks; images to what each view shows of people."""
