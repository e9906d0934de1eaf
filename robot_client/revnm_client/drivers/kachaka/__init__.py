"""Kachaka, a robot that speaks gRPC: needs the extra ``revnm-client[kachaka]``."""
