"""What scenes are made of: shapes, textures, stone figures."""
