"""Contacts: geometry, candidates, who touches whom, the columns of G."""
