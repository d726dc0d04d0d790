"""imaging chart"""
