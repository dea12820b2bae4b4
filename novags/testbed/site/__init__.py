"""A results site: one folder of pages on several studies, by method and by scene, that needs no server."""
