"""A bare body and an outfit in; garments, hair, shoes and headgear as meshes out.

A new garment is one entry of a table in `garments`.
"""
