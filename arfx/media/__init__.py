"""Video and images in and out: probe a clip, read its frames, edit them in place, encode,
join, and copy what is not touched.
"""
